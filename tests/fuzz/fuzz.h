/* fuzz: the targets of `make fuzz`, and what they share.
 *
 * A target is a function fuzz_NAME in fuzz_NAME.c that takes whatever bytes there are and ends the process
 * when something is wrong that no sanitizer sees. `make fuzz` links each with libFuzzer;
 * tests/unit/tests/test_corpus.c runs all of them on the seeds. They run from the repository's root.
 */
#ifndef LIGHTMILL_FUZZ_H
#define LIGHTMILL_FUZZ_H

#include "common/scene/blob_builder.h"
#include "worker/render/bsdf/bsdf.h"

/* The targets. They return 0, as libFuzzer wants it. */
int fuzz_allow_list(const uint8_t *data, size_t size);
int fuzz_blob(const uint8_t *data, size_t size);
int fuzz_body(const uint8_t *data, size_t size);
int fuzz_checkpoint(const uint8_t *data, size_t size);
int fuzz_draco(const uint8_t *data, size_t size);
int fuzz_fourier(const uint8_t *data, size_t size);
int fuzz_gltf(const uint8_t *data, size_t size);
int fuzz_http(const uint8_t *data, size_t size);
int fuzz_lens(const uint8_t *data, size_t size);
int fuzz_measured(const uint8_t *data, size_t size);
int fuzz_meshopt(const uint8_t *data, size_t size);
int fuzz_mitsuba(const uint8_t *data, size_t size);
int fuzz_nanovdb(const uint8_t *data, size_t size);
int fuzz_obj(const uint8_t *data, size_t size);
int fuzz_payload(const uint8_t *data, size_t size);
int fuzz_pbrt(const uint8_t *data, size_t size);
int fuzz_ply(const uint8_t *data, size_t size);
int fuzz_record(const uint8_t *data, size_t size);
int fuzz_render(const uint8_t *data, size_t size);
int fuzz_spectrum(const uint8_t *data, size_t size);
int fuzz_spool(const uint8_t *data, size_t size);
int fuzz_texture_image(const uint8_t *data, size_t size);
int fuzz_wire(const uint8_t *data, size_t size);

/* The path of a file in a folder of this process's own, which holds copies of tests/fuzz/assets and goes when
 * the process exits. Valid until the next call. */
const char *fuzz_path(const char *name);
/* Writes that file. */
void fuzz_write(const char *name, const void *data, size_t size);

/* Imports the file of that name as a scene: leniently, and strictly when there was a warning. Whatever is
 * accepted must be a blob that passes its checks. */
void fuzz_import(const char *name);
/* The same of a scene as it is at a time of its animations, blurred by a shutter. */
void fuzz_import_at(const char *name, double time, const char *shutter);

/* A copy of what may be a blob, with the size and the checksum that its header should have. The caller frees
 * it. */
uint8_t *fuzz_mend_blob(const uint8_t *data, size_t size);

/* Looks up every texture, image and density of a blob. */
void fuzz_walk(const scene_blob_t *blob);
/* A blob with a scene that has nothing in it but what the caller adds, and how it ends: opened, by its
 * checks; `bytes` is the caller's to free, after the blob's last use. */
blob_builder_t *fuzz_begin_blob(void);
void fuzz_end_blob(blob_builder_t **builder, uint8_t **bytes, scene_blob_t *blob);
/* Draws directions from all sides: whatever comes must be finite, and have a density. */
void fuzz_scatter(const lobe_t *lobe);

/* Ends the process with a message unless the condition holds. */
void fuzz_expect(bool condition, const char *what);

#endif
