/* fuzz_import_gltf: whatever the bytes are, the glTF importer gives a blob that opens, or an error.
 *
 * Both .gltf and .glb: the first bytes tell them apart. The file lives in memory, under a name of /proc.
 */
#include "client/import/gltf/gltf.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void drop_warning(void *context, const char *message)
{
    (void)context;
    if (message[0] == '\0') abort();
}

static result_t import(const char *path, uint8_t **bytes, uint64_t *length)
{
    import_report_t sink = {.warn = drop_warning};
    report_t report = report_begin(&sink);
    blob_builder_t *builder = blob_builder_new();
    result_t result = gltf_import(path, builder, &report);
    if (result.code == RESULT_OK) result = blob_builder_finish(builder, bytes, length);
    blob_builder_destroy(&builder);
    return result;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    char path[40];
    uint8_t *bytes = NULL;
    uint64_t length = 0;
    int file = memfd_create("scene", MFD_CLOEXEC);
    if (file < 0 || write(file, data, size) != (ssize_t)size) abort();
    snprintf(path, sizeof path, "/proc/self/fd/%d", file);
    result_t result = import(path, &bytes, &length);
    if (result.code != RESULT_OK && result.message[0] == '\0') abort();
    /* what the importer wrote must be a blob: that it is refused only by the blob's checks would be a bug,
     * except for sizes */
    scene_blob_t blob;
    if (result.code == RESULT_OK && blob_open(bytes, length, &blob).code != RESULT_OK) abort();
    if (strncmp(result.message, "scene blob:", 11) == 0) {
        fprintf(stderr, "%s\n", result.message);
        abort();
    }
    free(bytes);
    close(file);
    return 0;
}
