/* files: the files of a pbrt scene: the main one, and those that it includes.
 *
 * An included file is read in place, token by token: at its end reading goes on behind the Include, even in
 * the middle of a directive. So a file may end with the first parameters of a directive whose others follow
 * the Include. Both pbrts read so.
 *
 * Positions keep pointing to a file's path until the end of the import; its text is dropped when it has been
 * read.
 */
#ifndef LIGHTMILL_PBRT_FILES_H
#define LIGHTMILL_PBRT_FILES_H

#include "client/import/pbrt/state/state.h"

/* Opens the main file, and makes the lexer stand at its beginning. `label`: see source_t. */
result_t pbrt_open_main(pbrt_t *p, const char *path, const char *label);
/* Makes the lexer stand at the beginning of a file that the scene names. `apart`: its end is an end, behind
 * which pbrt_leave_apart goes on. RESULT_INPUT when it cannot be read, includes itself, or too many came
 * before. */
result_t pbrt_enter(pbrt_t *p, const char *name, bool apart, position_t at);
/* Goes back to the file that entered the innermost one `apart`, whose number on the stack of open files was
 * `depth`. */
void pbrt_leave_apart(pbrt_t *p, int depth);
/* Drops the files that the lexer has left. To be called when no token of theirs is in use. */
void pbrt_drop_left_files(pbrt_t *p);
/* Tells now and then how many bytes have been read. */
void pbrt_tell_progress(pbrt_t *p);

#endif
