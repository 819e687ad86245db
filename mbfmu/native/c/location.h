/* The address of a folder, as a host of FMI 2.0 gives it. */

#ifndef MBFMU_LOCATION_H
#define MBFMU_LOCATION_H

/* Turn the address of a folder into its path, which is not longer: file:/, file:/// or file://MACHINE/, with encoded
 * characters (%20); a path remains what it is. */
void read_location(const char *location, char *path);

#endif
