/* import: a scene file of somebody else's format becomes our scene blob.
 *
 * The format is chosen by the file's extension: one table entry each. Importing either succeeds, with
 * warnings for what was left out because it hardly changes the picture, or fails with one error that names
 * the file, the line, the column and the cure. docs/import.md lists what is supported.
 */
#ifndef LIGHTMILL_IMPORT_H
#define LIGHTMILL_IMPORT_H

#include "client/import/scene/report.h"
#include "common/scene/blob_builder.h"

/* Reads the scene at `path` into an empty builder. A directory stands for the scene.pbrt in it. `report` may
 * be NULL, and so may its `warn`: warnings then go to the log. After an error the builder is only fit to be
 * destroyed. RESULT_INPUT: the file, or one it refers to, is missing, malformed or not supported. */
result_t import_scene(const char *path, blob_builder_t *builder, const import_report_t *report);

/* The same as one blob in a file without a name, as blob_builder_write makes it; the caller closes *file. A
 * file that already is a blob is not a scene here: see blob_recognise. */
result_t import_scene_file(const char *path, const import_report_t *report, int *file);
/* The same as one finished blob in memory; the caller frees *bytes. */
result_t import_scene_blob(const char *path, const import_report_t *report, uint8_t **bytes, uint64_t *size);

/* True when the wishes ask for something that import_changed_file gives a scene which is a blob already, or
 * refuses. */
bool import_changes_blobs(const import_wishes_t *wishes);
/* Makes another blob of a checked one, with what the report's wishes ask for, as import_scene_file does. */
result_t import_changed_file(const scene_blob_t *blob, const import_report_t *report, int *file);

#endif
