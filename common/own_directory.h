/* own_directory: a directory whose files are nobody else's business: the scenes, images and keys of a master.
 */
#ifndef LIGHTMILL_OWN_DIRECTORY_H
#define LIGHTMILL_OWN_DIRECTORY_H

#include "common/base.h"

/* Makes the directory, with its parents, where it is missing: only this user may enter it. Takes the rights
 * of others from one that is there (earlier versions left them), and from what is in it under one of the
 * `names`, patterns like "job-*.exr", the last NULL, with all below that; says so in the log. What belongs to
 * another user, or is a directory that all may write to, like /tmp, stays as it is; symbolic links are not
 * followed.
 *
 * New files in it are to be made by a process with the umask 077. */
result_t own_directory_open(const char *path, const char *const *names);

/* Takes the directory's path out of a message that goes to another machine, wherever it stands in it:
 * "/srv/farm/films/job-1.1.film is damaged" becomes "films/job-1.1.film is damaged". Returns true when there
 * was something to take. `path` may be NULL: nothing is hidden. */
bool own_directory_hide(const char *path, char *message);

#endif
