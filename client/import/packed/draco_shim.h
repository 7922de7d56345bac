/* draco_shim: libdraco, which speaks C++, for C. It is called in a confined process (confined.h). */
#ifndef LIGHTMILL_DRACO_SHIM_H
#define LIGHTMILL_DRACO_SHIM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What the shim writes of an attribute; the type is glTF's componentType. */
typedef struct {
    uint32_t components, type, normalized;
} draco_shim_attribute_t;

/* What was asked for. */
typedef struct {
    const uint8_t *data;
    size_t size;
    const uint32_t *ids; /* unique ids of attributes */
    size_t id_count;
} draco_shim_request_t;

typedef enum {
    DRACO_SHIM_OK,
    DRACO_SHIM_DAMAGED,      /* not Draco, or damaged */
    DRACO_SHIM_NO_ATTRIBUTE, /* one of the ids is unknown, or its type is */
    DRACO_SHIM_NO_MEMORY,
    DRACO_SHIM_NOT_WRITTEN
} draco_shim_status_t;

/* Writes to the file `output`: two uint32_t, the number of points and of triangles; a draco_shim_attribute_t
 * for each id; three uint32_t a triangle; for each id its values. Throws nothing. */
draco_shim_status_t draco_shim_unpack(const draco_shim_request_t *request, int output);

#ifdef __cplusplus
}
#endif

#endif
