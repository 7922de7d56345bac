/* draco: meshes packed by Draco (KHR_draco_mesh_compression), through libdraco.
 *
 * There are open reports of damaged bytes that make libdraco write beyond its memory (google/draco, issues
 * 1102 and 1103), and few bytes can make it ask for much memory. So it runs confined (confined.h), and what
 * it made is checked here.
 */
#ifndef LIGHTMILL_DRACO_H
#define LIGHTMILL_DRACO_H

#include "client/import/packed/confined.h"

enum { DRACO_MOST_ATTRIBUTES = 32 };

/* An attribute of an unpacked mesh: [points][components], without gaps and of any alignment, in the mesh's
 * memory. */
typedef struct {
    uint32_t components; /* 1 to 4 */
    uint32_t type;       /* as glTF numbers componentType: 5120 int8 to 5126 float */
    bool normalized;     /* integers are fractions, as Draco has it */
    const uint8_t *data;
} draco_attribute_t;

/* An unpacked mesh: triangles of points. Free it with draco_free. */
typedef struct {
    uint32_t points;
    uint32_t triangles;
    const uint32_t *corners; /* [triangles][3]; may be points that do not exist */
    draco_attribute_t attributes[DRACO_MOST_ATTRIBUTES];
    confined_result_t memory;
} draco_mesh_t;

/* Unpacks the attributes with these unique ids, at most DRACO_MOST_ATTRIBUTES, in this order, and the
 * triangles. RESULT_INPUT when the bytes are damaged, hold no mesh, lack an attribute, or ask for more time
 * or memory than their size justifies; RESULT_LIMIT as confined_run. On failure there is nothing to free. */
result_t draco_unpack(const uint8_t *data, size_t size, const uint32_t *ids, size_t id_count,
                      draco_mesh_t *mesh);
/* What draco_unpack does with the bytes that came back, mesh->memory, which it does not trust: finds the
 * parts of the mesh in them. False when they are not there. */
bool draco_lay_out(size_t attributes, draco_mesh_t *mesh);
void draco_free(draco_mesh_t *mesh);

#endif
