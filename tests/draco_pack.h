/* draco_pack: packs meshes by Draco's own encoder, so that tests need no files of others. */
#ifndef LIGHTMILL_DRACO_PACK_H
#define LIGHTMILL_DRACO_PACK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The unique ids of the attributes. */
enum { DRACO_PACK_POSITION, DRACO_PACK_NORMAL, DRACO_PACK_UV, DRACO_PACK_COLOUR };

typedef struct {
    uint32_t vertices, triangles;
    const float *positions, *normals, *uvs; /* [vertices][3], [3] and [2]; NULL: none */
    const uint8_t *colours;                 /* [vertices][4], fractions of 255; NULL: none */
    const uint16_t *corners;                /* [triangles][3] */
    bool reorder;                           /* by the edgebreaker; false: the order stays */
    int bits;                               /* of positions, normals and uvs; 0: floats as they are */
} draco_pack_t;

/* The packed bytes in fresh memory; NULL when the encoder fails. */
uint8_t *draco_pack(const draco_pack_t *mesh, size_t *size);

#ifdef __cplusplus
}
#endif

#endif
