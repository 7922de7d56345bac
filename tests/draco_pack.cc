/* draco_pack: see draco_pack.h. */
#include "tests/draco_pack.h"

#include <cstdlib>
#include <cstring>

#include <draco/compression/encode.h>

namespace
{

using draco::GeometryAttribute;

void add(draco::Mesh &mesh, GeometryAttribute::Type type, draco::DataType data, int components, uint32_t id,
         const void *values)
{
    if (!values) return;
    size_t size = static_cast<size_t>(components) * static_cast<size_t>(draco::DataTypeLength(data));
    GeometryAttribute about;
    about.Init(type, nullptr, static_cast<int8_t>(components), data, data != draco::DT_FLOAT32,
               static_cast<int64_t>(size), 0);
    draco::PointAttribute *attribute = mesh.attribute(mesh.AddAttribute(about, true, mesh.num_points()));
    attribute->set_unique_id(id);
    for (uint32_t i = 0; i < mesh.num_points(); ++i)
        attribute->SetAttributeValue(draco::AttributeValueIndex(i),
                                     static_cast<const uint8_t *>(values) + i * size);
}

void fill(const draco_pack_t &from, draco::Mesh &mesh)
{
    mesh.set_num_points(from.vertices);
    mesh.SetNumFaces(from.triangles);
    for (uint32_t i = 0; i < from.triangles; ++i) {
        draco::Mesh::Face face;
        for (uint32_t k = 0; k < 3; ++k) face[k] = draco::PointIndex(from.corners[3 * i + k]);
        mesh.SetFace(draco::FaceIndex(i), face);
    }
    add(mesh, GeometryAttribute::POSITION, draco::DT_FLOAT32, 3, DRACO_PACK_POSITION, from.positions);
    add(mesh, GeometryAttribute::NORMAL, draco::DT_FLOAT32, 3, DRACO_PACK_NORMAL, from.normals);
    add(mesh, GeometryAttribute::TEX_COORD, draco::DT_FLOAT32, 2, DRACO_PACK_UV, from.uvs);
    add(mesh, GeometryAttribute::COLOR, draco::DT_UINT8, 4, DRACO_PACK_COLOUR, from.colours);
}

} // namespace

uint8_t *draco_pack(const draco_pack_t *from, size_t *size)
{
    draco::Mesh mesh;
    fill(*from, mesh);
    draco::Encoder encoder;
    encoder.SetEncodingMethod(from->reorder ? draco::MESH_EDGEBREAKER_ENCODING
                                            : draco::MESH_SEQUENTIAL_ENCODING);
    if (from->bits > 0)
        for (auto type :
             {GeometryAttribute::POSITION, GeometryAttribute::NORMAL, GeometryAttribute::TEX_COORD})
            encoder.SetAttributeQuantization(type, from->bits);
    draco::EncoderBuffer buffer;
    if (!encoder.EncodeMeshToBuffer(mesh, &buffer).ok()) return nullptr;
    auto *bytes = static_cast<uint8_t *>(std::malloc(buffer.size()));
    if (bytes) std::memcpy(bytes, buffer.data(), buffer.size());
    *size = buffer.size();
    return bytes;
}
