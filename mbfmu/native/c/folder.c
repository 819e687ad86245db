/* Shared libraries in the folder of this one: they are loaded by their full paths, for this library alone. */

#if defined(__linux__) && !defined(_GNU_SOURCE)
#define _GNU_SOURCE /* dladdr */
#endif

#include "folder.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

#define READ_AT_ONCE 4096 /* bytes */

/* Whether a file is a library that the export has put into the FMU: a file that is cut off would end the process when it
 * is loaded, and that of another FMU has other kernels. */
static bool is_known_library(const Instance *own, FILE *file, char why[SAYS])
{
    unsigned char bytes[READ_AT_ONCE];
    int64_t length = 0;
    uint64_t sum = 0;
    for (size_t count; file && (count = fread(bytes, 1, sizeof bytes, file)) > 0; length += (int64_t)count)
        sum = crc64(sum, bytes, count);
    if (file)
        fclose(file);
    for (int64_t k = 0; k < own->header->libraries_count; k++)
        if (own->libraries[k].length == length && (uint64_t)own->libraries[k].sum == sum)
            return true;
    SAY(why, "the file is damaged, or belongs to another FMU");
    return false;
}

#ifdef _WIN32

#include <wchar.h>
#include <windows.h>

#define MAX_PATH_LENGTH 4096

void *load_beside(const Instance *own, const char *beginning, char why[SAYS])
{
    wchar_t path[MAX_PATH_LENGTH], wide[MAX_PATH_LENGTH / 4];
    HMODULE self, found = NULL;
    WIN32_FIND_DATAW file;
    SAY(why, "the folder of the library is not known");
    if (!GetModuleHandleExW(GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                            (const wchar_t *)load_beside, &self))
        return NULL;
    DWORD length = GetModuleFileNameW(self, path, MAX_PATH_LENGTH);
    wchar_t *name = length && length < MAX_PATH_LENGTH ? wcsrchr(path, L'\\') : NULL;
    size_t room = name ? (size_t)(path + MAX_PATH_LENGTH - ++name) : 0;
    if (!MultiByteToWideChar(CP_UTF8, 0, beginning, -1, wide, MAX_PATH_LENGTH / 4) || room < wcslen(wide) + 2)
        return NULL;
    wcscpy(name, wide);
    wcscat(name, L"*");
    HANDLE search = FindFirstFileW(path, &file);
    SAY(why, "there is no such file");
    if (search == INVALID_HANDLE_VALUE)
        return NULL;
    FindClose(search);
    if (room > wcslen(file.cFileName)) {
        wcscpy(name, file.cFileName);
        if (!is_known_library(own, _wfopen(path, L"rb"), why))
            return NULL;
        found = LoadLibraryExW(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
        SAY(why, "it is not a library for this machine");
    }
    return (void *)found;
}

void *function_of(void *library, const char *name)
{
    return (void *)GetProcAddress((HMODULE)library, name);
}

void unload(void *library)
{
    FreeLibrary((HMODULE)library);
}

#else

#include <dirent.h>
#include <dlfcn.h>

/* Return the path of the file in a folder, given with its last separator, whose name begins so; NULL: there is none. */
static char *path_beside(const char *folder, size_t length, const char *beginning)
{
    char *place = malloc(length + 1), *path = NULL;
    if (!place)
        return NULL;
    memcpy(place, folder, length);
    place[length] = '\0';
    DIR *files = opendir(place);
    for (const struct dirent *file = files ? readdir(files) : NULL; file && !path; file = readdir(files))
        if (strncmp(file->d_name, beginning, strlen(beginning)) == 0) {
            size_t count = strlen(file->d_name) + 1;
            path = malloc(length + count);
            if (path) {
                memcpy(path, place, length);
                memcpy(path + length, file->d_name, count);
            }
        }
    if (files)
        closedir(files);
    free(place);
    return path;
}

void *load_beside(const Instance *own, const char *beginning, char why[SAYS])
{
    Dl_info self;
    const char *end = dladdr((const void *)load_beside, &self) && self.dli_fname ? strrchr(self.dli_fname, '/') : NULL;
    char *path = end ? path_beside(self.dli_fname, (size_t)(end + 1 - self.dli_fname), beginning)
                     : path_beside("./", 2, beginning);
    bool known = path && is_known_library(own, fopen(path, "rb"), why);
    void *found = known ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : NULL;
    if (!path)
        SAY(why, "there is no such file");
    else if (known && !found) {
        const char *error = dlerror();
        SAY(why, error ? error : "it is not a library for this machine");
    }
    free(path);
    return found;
}

void *function_of(void *library, const char *name)
{
    return dlsym(library, name);
}

void unload(void *library)
{
    dlclose(library);
}

#endif
