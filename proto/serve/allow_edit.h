/* allow_edit: changes the list of keys that a master lets in (allow_list.h) as a careful person does:
 * comments and the other lines stay as they are, and a master that reads the file sees all of a change or
 * nothing of it. */
#ifndef LIGHTMILL_ALLOW_EDIT_H
#define LIGHTMILL_ALLOW_EDIT_H

#include "proto/serve/allow_list.h"

/* Adds a line like "worker KEY NAME" at the end. `*there`: the list had the key with this right already, and
 * stays as it is. RESULT_INPUT when the line is no such line, the key has another right, or the list has a
 * mistake. `entry` is what was added. */
result_t allow_edit_add(const char *path, const char *line, allow_entry_t *entry, bool *there);
/* Makes a comment of the line of a key, or of the only key of this name, that says since when. RESULT_INPUT
 * when there is none, or there are several. `entry` is what was there. */
result_t allow_edit_remove(const char *path, const char *who, allow_entry_t *entry);

#endif
