/* disk: a small file system in memory for the master's data, which can be filled up. */
#ifndef LIGHTMILL_DISK_H
#define LIGHTMILL_DISK_H

#include "common/base.h"

/* Mounts it on a folder; needs network_separate, so that it ends with the driver. RESULT_MISMATCH, saying
 * why, when that is not allowed. */
result_t disk_mount(const char *folder, size_t megabytes);
void disk_unmount(const char *folder);
/* Takes all the room that is left, then every bit that is given free, while it is called again. */
result_t disk_fill(const char *folder);
void disk_free(const char *folder);
/* Copies the folder to where it stays. */
result_t disk_save(const char *folder, const char *copy);

#endif
