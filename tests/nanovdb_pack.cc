/* nanovdb_pack: see nanovdb_pack.h. */
#include "tests/nanovdb_pack.h"

#define NANOVDB_USE_ZIP
#define NANOVDB_USE_BLOSC
#include <nanovdb/util/GridBuilder.h>
#include <nanovdb/util/IO.h>

#include <exception>
#include <vector>

namespace
{

nanovdb::Map map_of(const nanovdb_pack_t &grid)
{
    double matrix[3][3] = {}, inverse[3][3] = {};
    for (int i = 0; i < 3; ++i) {
        matrix[i][i] = grid.voxel[i];
        inverse[i][i] = 1 / grid.voxel[i];
    }
    nanovdb::Map map;
    map.set(matrix, inverse, nanovdb::Vec3d(grid.origin[0], grid.origin[1], grid.origin[2]), 1.0);
    return map;
}

template <typename T> nanovdb::GridHandle<> build(const nanovdb_pack_t &grid)
{
    bool level_set = grid.sort == NANOVDB_PACK_LEVEL_SET;
    nanovdb::GridBuilder<T> builder(static_cast<T>(grid.background),
                                    level_set ? nanovdb::GridClass::LevelSet : nanovdb::GridClass::FogVolume);
    auto value = [&](const nanovdb::Coord &p) {
        return static_cast<T>(grid.at(grid.context, p[0], p[1], p[2]));
    };
    builder(value, nanovdb::CoordBBox(nanovdb::Coord(grid.low[0], grid.low[1], grid.low[2]),
                                      nanovdb::Coord(grid.high[0], grid.high[1], grid.high[2])));
    return builder.getHandle(map_of(grid), grid.name);
}

} // namespace

bool nanovdb_pack(const char *path, const nanovdb_pack_t *grids, size_t count, nanovdb_codec_t codec)
try {
    std::vector<nanovdb::GridHandle<>> handles;
    for (size_t i = 0; i < count; ++i)
        handles.push_back(grids[i].sort == NANOVDB_PACK_DOUBLES ? build<double>(grids[i])
                                                                : build<float>(grids[i]));
    nanovdb::io::writeGrids(path, handles, static_cast<nanovdb::io::Codec>(codec));
    return true;
} catch (const std::exception &) {
    return false;
}
