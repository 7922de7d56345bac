/* nanovdb_pack: writes NanoVDB files by NanoVDB's own builder, so that tests need no files of others. */
#ifndef LIGHTMILL_NANOVDB_PACK_H
#define LIGHTMILL_NANOVDB_PACK_H

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum { NANOVDB_PACK_NONE, NANOVDB_PACK_ZIP, NANOVDB_PACK_BLOSC } nanovdb_codec_t;
typedef enum { NANOVDB_PACK_FLOATS, NANOVDB_PACK_DOUBLES, NANOVDB_PACK_LEVEL_SET } nanovdb_sort_t;

/* A grid. Voxels are active where the number is not the background; leaves and nodes of one number become
 * tiles. */
typedef struct {
    const char *name;
    nanovdb_sort_t sort;
    int low[3], high[3]; /* voxels from ... to, both included */
    float (*at)(const void *context, int x, int y, int z);
    const void *context;
    double voxel[3], origin[3]; /* the sides of a voxel, and where voxel 0 lies in the world */
    float background;
} nanovdb_pack_t;

/* False when it cannot be written. */
bool nanovdb_pack(const char *path, const nanovdb_pack_t *grids, size_t count, nanovdb_codec_t codec);

#ifdef __cplusplus
}
#endif

#endif
