/* The model as data: a file that stands in the resources of the FMU. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "folder.h"
#include "instance.h"
#include "sundials.h"

#ifdef _WIN32
#include <windows.h>
#endif

#define ALIGNED 64 /* bytes */
#define FILE_NAME "/model.bin"

static FILE *open_file(const char *path)
{
#ifdef _WIN32
    wchar_t wide[4096];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, (int)(sizeof wide / sizeof wide[0])))
        return NULL;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

const void *section(const Instance *own, int64_t at)
{
    return own->tables + at;
}

const char *text_at(const Instance *own, int64_t at)
{
    return own->tables + own->header->text + at;
}

/* Return how many bytes of the block a state consists of; co-simulation needs none of those of model exchange. */
size_t saved_bytes(const Instance *own)
{
    return (size_t)(own->exchange ? own->header->saved : own->header->saved_alone);
}

/* Return what every entry point is called with. */
unsigned char *root_of(Instance *own)
{
    own->advanced = false;
    return own->block + own->header->root;
}

/* Return the length of a file in bytes; negative: it is not known. */
static int64_t length_of(FILE *file)
{
    int64_t length = fseek(file, 0, SEEK_END) ? -1 : (int64_t)ftell(file);
    return fseek(file, 0, SEEK_SET) ? -1 : length;
}

/* Whether the tables are those of the export: their checksum is taken with the field that holds it at zero. */
static bool are_whole(const char *tables, const Header *h)
{
    const int64_t none = 0;
    size_t before = offsetof(Header, table_sum), after = before + sizeof none;
    uint64_t sum = crc64(crc64(0, tables, before), &none, sizeof none);
    return crc64(sum, tables + after, (size_t)h->block - after) == (uint64_t)h->table_sum;
}

/* Read the lengths and checksums of the libraries, which follow the block. */
static bool read_libraries(Instance *own, FILE *file)
{
    const Header *h = own->header;
    size_t size = (size_t)h->libraries_count * sizeof(Library);
    own->libraries = malloc(size ? size : 1);
    return own->libraries && !fseek(file, (long)(h->block + h->size), SEEK_SET) && fread(own->libraries, 1, size, file) == size &&
           crc64(0, own->libraries, size) == (uint64_t)h->libraries_sum;
}

/* Read the header and the tables, and check them; say what is wrong with the file. */
static bool read_tables(Instance *own, FILE *file, const char *token, char text[SAYS])
{
    Header header;
    int64_t length = length_of(file);
    if (fread(&header, sizeof header, 1, file) != 1 || header.magic != MAGIC) {
        SAY(text, "file '", own->path, "' is not a model of this version of mbfmu; export the FMU again [fmu-files]");
        return false;
    }
    if (!has_length(&header, length)) {
        SAY(text, "file '", own->path, "' is damaged: its length is not that of its header; unzip the FMU again [fmu-files]");
        return false;
    }
    own->tables = malloc((size_t)header.block);
    if (!own->tables) {
        SAY(text, "the memory for the instance cannot be allocated [out-of-memory]");
        return false;
    }
    if (fseek(file, 0, SEEK_SET) || fread(own->tables, (size_t)header.block, 1, file) != 1 ||
        !are_whole(own->tables, (const Header *)own->tables)) {
        SAY(text, "file '", own->path, "' is damaged: the checksum of its tables differs; unzip the FMU again [fmu-files]");
        return false;
    }
    own->header = (const Header *)own->tables;
    if (strncmp(own->header->token, token, sizeof own->header->token) != 0) {
        SAY(text, "the importing tool gives the GUID '", token, "', but the model file has another one; unzip the FMU again "
                                                          "[fmu-files]");
        return false;
    }
    if (!within_bounds(own)) {
        SAY(text, "file '", own->path, "' is damaged: it refers to data outside the file; export the FMU again [fmu-files]");
        return false;
    }
    if (!read_libraries(own, file)) {
        SAY(text, "file '", own->path, "' is damaged: the checksum of its libraries differs; unzip the FMU again [fmu-files]");
        return false;
    }
    own->family = &family;
    return true;
}

static void put_address(Instance *own, int64_t at, const void *address)
{
    memcpy(own->block + at, &address, sizeof address);
}

/* Load the user-defined kernels of the model, if it has some; without them the text says why. */
static bool open_user_library(Instance *own, char text[SAYS])
{
    char why[SAYS];
    if (!own->header->user_kernels)
        return true;
    own->user_library = load_beside(own, USER_LIBRARY, why);
    if (own->user_library && function_of(own->user_library, USER_TABLE))
        return true;
    SAY(text, "library '" USER_LIBRARY "' of the user-defined kernels, which must be in the folder of the FMU's own library, cannot "
        "be loaded: ", own->user_library ? "it has no kernels" : why, "; unzip the FMU again, or export it for this machine "
        "[fmu-files]");
    return false;
}

static bool read_block(Instance *own, FILE *file)
{
    const Header *h = own->header;
    void *const *own_kernels = own->user_library ? function_of(own->user_library, USER_TABLE) : NULL;
    free_objects(own);
    if (fseek(file, (long)h->block, SEEK_SET) || fread(own->block, (size_t)h->size, 1, file) != 1 ||
        crc64(0, own->block, (size_t)h->size) != (uint64_t)h->block_sum)
        return false;
    const Relocation *relocations = section(own, h->relocations), *kernels = section(own, h->kernels);
    for (int64_t k = 0; k < h->relocations_count; k++)
        put_address(own, relocations[k].at, own->block + relocations[k].target);
    for (int64_t k = 0; k < h->kernels_count; k++) {
        int64_t number = kernels[k].target;
        const KernelTable *table = table_of(&number);
        put_address(own, kernels[k].at, table ? table->addresses[number] : own_kernels[number]);
    }
    if (own->sundials)
        fill_table(own);
    own->untouched = true;
    return true;
}

/* Let the block be that of the file, with the addresses of this process. */
bool load_block(Instance *own)
{
    FILE *file = open_file(own->path);
    bool well = file && read_block(own, file);
    if (file)
        fclose(file);
    return well;
}

/* Read a model from its folder, and have room for it. */
bool open_model(Instance *own, const char *folder, const char *token, char text[SAYS])
{
    size_t length = strlen(folder);
    while (length && (folder[length - 1] == '/' || folder[length - 1] == '\\'))
        length--;
    own->path = malloc(length + sizeof FILE_NAME);
    if (!own->path) {
        SAY(text, "the memory for the instance cannot be allocated [out-of-memory]");
        return false;
    }
    memcpy(own->path, folder, length);
    memcpy(own->path + length, FILE_NAME, sizeof FILE_NAME);
    FILE *file = open_file(own->path);
    if (!file) {
        SAY(text, "file '", own->path, "' cannot be read; the FMU needs the folder of its resources [fmu-files]");
        return false;
    }
    bool well = read_tables(own, file, token, text);
    if (well) {
        size_t size = (size_t)own->header->size;
        own->room = malloc(size + ALIGNED);
        own->kept = calloc((size_t)own->header->saved, 1);
        own->values = malloc(count_of(own) * sizeof *own->values);
        own->flags = calloc(flag_words(own), sizeof(uint64_t));
        well = own->room && own->kept && own->values && own->flags;
        if (well)
            own->block = own->room + (ALIGNED - (uintptr_t)own->room % ALIGNED) % ALIGNED;
        if (!well)
            SAY(text, "the memory for the instance cannot be allocated [out-of-memory]");
        else if ((own->header->ida_at && !open_sundials(own, text)) || !open_user_library(own, text))
            well = false;
        else if (!(well = read_block(own, file)))
            SAY(text, "file '", own->path, "' is damaged: the checksum of its model differs; unzip the FMU again [fmu-files]");
    }
    fclose(file);
    return well;
}
