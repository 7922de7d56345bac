/* meshopt: buffers packed by meshoptimizer (EXT_meshopt_compression), through its library. */
#ifndef LIGHTMILL_MESHOPT_H
#define LIGHTMILL_MESHOPT_H

#include "common/base.h"

typedef enum { MESHOPT_ATTRIBUTES, MESHOPT_TRIANGLES, MESHOPT_INDICES } meshopt_mode_t;
typedef enum { MESHOPT_NONE, MESHOPT_OCTAHEDRAL, MESHOPT_QUATERNION, MESHOPT_EXPONENTIAL } meshopt_filter_t;

/* What the packed bytes become: `count` elements of `stride` bytes each. */
typedef struct {
    meshopt_mode_t mode;
    meshopt_filter_t filter;
    uint64_t count, stride;
} meshopt_layout_t;

/* RESULT_INPUT when the layout breaks a rule of the extension, or is more than `size` packed bytes can hold.
 */
result_t meshopt_check(const meshopt_layout_t *layout, size_t size);
/* Checks the layout, and unpacks `size` bytes into fresh memory of count * stride bytes, which the caller
 * frees. RESULT_INPUT also when the bytes are damaged; RESULT_LIMIT when memory ran out. Indices may be of
 * vertices that do not exist. */
result_t meshopt_unpack(const meshopt_layout_t *layout, const uint8_t *data, size_t size, uint8_t **unpacked);

#endif
