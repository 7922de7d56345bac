/* draco_shim: see draco_shim.h. */
#include "client/import/packed/draco_shim.h"

#include <new>
#include <unistd.h>
#include <vector>

#include <draco/compression/decode.h>

namespace
{

/* glTF's componentType; 0 for a type that glTF has not, which becomes float. */
uint32_t component_type(draco::DataType type)
{
    switch (type) {
    case draco::DT_INT8:
        return 5120;
    case draco::DT_UINT8:
        return 5121;
    case draco::DT_INT16:
        return 5122;
    case draco::DT_UINT16:
        return 5123;
    case draco::DT_UINT32:
        return 5125;
    case draco::DT_FLOAT32:
        return 5126;
    default:
        return 0;
    }
}

draco_shim_attribute_t description(const draco::PointAttribute &attribute)
{
    uint32_t type = component_type(attribute.data_type());
    bool normalized = attribute.normalized() && type != 0;
    return {static_cast<uint32_t>(attribute.num_components()), type ? type : 5126, normalized};
}

/* The whole result, in the order in which it is written. */
class Result
{
  public:
    template <typename T> void add(const T *items, size_t count)
    {
        const auto *first = reinterpret_cast<const uint8_t *>(items);
        bytes_.insert(bytes_.end(), first, first + count * sizeof(T));
    }

    /* The values at all points, as Draco has them. */
    void add_values(const draco::PointAttribute &attribute, uint32_t points)
    {
        size_t size =
            static_cast<size_t>(draco::DataTypeLength(attribute.data_type())) * attribute.num_components();
        for (uint32_t i = 0; i < points; ++i)
            add(attribute.GetAddress(attribute.mapped_index(draco::PointIndex(i))), size);
    }

    /* The same as floats. */
    bool add_floats(const draco::PointAttribute &attribute, uint32_t points)
    {
        for (uint32_t i = 0; i < points; ++i) {
            float values[4] = {};
            if (!attribute.ConvertValue<float>(attribute.mapped_index(draco::PointIndex(i)), values))
                return false;
            add(values, static_cast<size_t>(attribute.num_components()));
        }
        return true;
    }

    bool write_to(int output) const
    {
        for (size_t done = 0; done < bytes_.size();) {
            ssize_t written = write(output, bytes_.data() + done, bytes_.size() - done);
            if (written <= 0) return false;
            done += static_cast<size_t>(written);
        }
        return true;
    }

  private:
    std::vector<uint8_t> bytes_;
};

bool add_attribute(const draco::PointAttribute &attribute, uint32_t points, Result &result)
{
    if (component_type(attribute.data_type()) == 0) return result.add_floats(attribute, points);
    result.add_values(attribute, points);
    return true;
}

using Attributes = std::vector<const draco::PointAttribute *>;

draco_shim_status_t find_attributes(const draco::Mesh &mesh, const draco_shim_request_t &request,
                                    Attributes &found)
{
    for (size_t i = 0; i < request.id_count; ++i) {
        const draco::PointAttribute *attribute = mesh.GetAttributeByUniqueId(request.ids[i]);
        if (!attribute || attribute->num_components() < 1 || attribute->num_components() > 4)
            return DRACO_SHIM_NO_ATTRIBUTE;
        found.push_back(attribute);
    }
    return DRACO_SHIM_OK;
}

void add_triangles(const draco::Mesh &mesh, Result &result)
{
    for (uint32_t i = 0; i < mesh.num_faces(); ++i) {
        const draco::Mesh::Face &face = mesh.face(draco::FaceIndex(i));
        const uint32_t corners[3] = {face[0].value(), face[1].value(), face[2].value()};
        result.add(corners, 3);
    }
}

draco_shim_status_t unpack(const draco_shim_request_t &request, int output)
{
    draco::DecoderBuffer buffer;
    buffer.Init(reinterpret_cast<const char *>(request.data), request.size);
    auto decoded = draco::Decoder().DecodeMeshFromBuffer(&buffer);
    if (!decoded.ok()) return DRACO_SHIM_DAMAGED;
    const draco::Mesh &mesh = *decoded.value();
    Attributes attributes;
    draco_shim_status_t status = find_attributes(mesh, request, attributes);
    if (status != DRACO_SHIM_OK) return status;
    Result result;
    const uint32_t counts[2] = {mesh.num_points(), mesh.num_faces()};
    result.add(counts, 2);
    for (const auto *attribute : attributes) {
        const draco_shim_attribute_t about = description(*attribute);
        result.add(&about, 1);
    }
    add_triangles(mesh, result);
    for (const auto *attribute : attributes)
        if (!add_attribute(*attribute, counts[0], result)) return DRACO_SHIM_NO_ATTRIBUTE;
    return result.write_to(output) ? DRACO_SHIM_OK : DRACO_SHIM_NOT_WRITTEN;
}

} // namespace

draco_shim_status_t draco_shim_unpack(const draco_shim_request_t *request, int output)
{
    try {
        return unpack(*request, output);
    } catch (const std::bad_alloc &) {
        return DRACO_SHIM_NO_MEMORY;
    } catch (...) {
        return DRACO_SHIM_DAMAGED;
    }
}
