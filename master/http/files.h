/* files: the page's files (web/), which are part of the program. */
#ifndef LIGHTMILL_HTTP_FILES_H
#define LIGHTMILL_HTTP_FILES_H

#include "master/http/request.h"

/* Answers with the file that the path names ("/" is index.html); false, without an answer, when there is
 * none. */
bool http_files_serve(http_request_t *request);
/* True when the path is that of a file. */
bool http_files_have(const char *path);

#endif
