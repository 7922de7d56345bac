/* fingerprint: see fingerprint.h.
 *
 * DESIGN. Everything that a unit's bits depend on beside the job is the program, the C library, Embree and
 * the processor. The program is built for one baseline, so what may differ is what is chosen at run time: the
 * C library has several versions of its functions, Embree has kernels for several instruction sets. The scene
 * has some of everything that takes a path of its own through either: triangles, quadrics, curves, instances
 * that move; images and noise; lights of every shape; and a material of each kind of lobe. A render of a few
 * ms meets few arguments of sin and exp, so these are also walked through directly. */
#include "worker/render/fingerprint.h"

#include "common/scene/blob_builder.h"
#include "worker/render/renderer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { RESOLUTION = 24, SAMPLES = 4, POINTS = 2048 };

/* ---- the scene ----------------------------------------------------------------------------------------- */

static xform_t placed(float x, float y, float z)
{
    return (xform_t){{{1, 0, 0, x}, {0, 1, 0, y}, {0, 0, 1, z}}};
}

static void add_scene(blob_builder_t *b)
{
    blob_scene_t scene = blob_default_scene();
    scene.world_from_camera = placed(0, 0, -5);
    scene.world_from_camera_end = placed(0.02f, 0, -5);
    scene.fov = 62;
    scene.lens_radius = 0.05f;
    scene.focal_distance = 5;
    scene.filter = (blob_filter_t){FILTER_GAUSSIAN, 1.5f, 1.5f, {0.5f, 0}};
    blob_builder_add(b, BLOB_SECTION_SCENE, &scene, 1);
}

/* Texture 1 is an image in sRGB, 2 is noise, 3 their mixture. */
static void add_textures(blob_builder_t *b)
{
    static const uint32_t texels[4] = {0xFF2040C0u, 0xFF30A050u, 0xFFE08010u, 0xFF907060u};
    const blob_image_t image = {TEXELS_RGBA8, 2, 2, blob_builder_add(b, BLOB_SECTION_TEXELS, texels, 4), 0};
    const blob_texture_t textures[] = {
        {.kind = TEXTURE_IMAGE,
         .mapping = MAPPING_UV,
         .matrix = {{3, 0, 0}, {0, -2, 1}},
         .image = 1,
         .channel = CHANNEL_RGB,
         .wrap_s = WRAP_REPEAT,
         .wrap_t = WRAP_MIRROR,
         .inputs = {{{1, 1, 1}, 0, 0}}},
        {.kind = TEXTURE_FBM,
         .mapping = MAPPING_POINT,
         .texture_from_world = xform_identity(),
         .parameters = {4, 0.5f}},
        {.kind = TEXTURE_MIX, .inputs = {{{1, 1, 1}, 1, 0}, {{0.9f, 0.5f, 0.2f}, 2, 0}, {{0.5f}, 0, 0}}}};
    blob_builder_add(b, BLOB_SECTION_IMAGES, &image, 1);
    blob_builder_add(b, BLOB_SECTION_TEXTURES, textures, ARRAY_LENGTH(textures));
}

/* A surface that scatters both ways, by series of three terms between two nodes. */
static void add_fourier(blob_builder_t *b)
{
    enum { NODES = 2, CELLS = FOURIER_AZIMUTHS + 1 };
    static const float series[3] = {0.3f, 0.1f, 0.05f}, nodes[NODES] = {-1, 1},
                       rows[2 * NODES] = {0, 1, 0, 1};
    float cells[NODES * CELLS];
    for (uint32_t i = 0; i < NODES * CELLS; i++) cells[i] = (float)(i % CELLS) / FOURIER_AZIMUTHS;
    uint32_t first = blob_builder_add(b, BLOB_SECTION_NUMBERS, series, 3);
    const blob_series_t pairs[NODES * NODES] = {{first, 2}, {first, 3}, {first, 3}, {first, 2}};
    blob_fourier_t table = {.nodes = NODES, .channels = 1, .eta = 1.2f, .albedo = {0.5f, 0.5f, 0.5f}};
    table.first_series = blob_builder_add(b, BLOB_SECTION_SERIES, pairs, NODES * NODES);
    table.first_node = blob_builder_add(b, BLOB_SECTION_NUMBERS, nodes, NODES);
    table.first_marginal = blob_builder_add(b, BLOB_SECTION_NUMBERS, rows, 2 * NODES);
    table.first_conditional = blob_builder_add(b, BLOB_SECTION_NUMBERS, cells, NODES * CELLS);
    blob_builder_add(b, BLOB_SECTION_FOURIERS, &table, 1);
}

/* A measured BRDF of one slice with grids of 2 x 2 numbers. */
static void add_measured(blob_builder_t *b)
{
    static const float directions[2] = {0, 0}, flat[4] = {1.1f, 0.9f, 0.8f, 1.2f};
    static const float warp[10] = {0.8f, 1.2f, 0.9f, 1.1f, 0, 1, 0, 1, 0, 1}; /* densities and sums */
    static const float colours[12] = {0.5f, 0.6f, 0.3f, 0.4f, 0.2f, 0.7f, 0.3f, 0.5f, 0.6f, 0.1f, 0.2f, 0.9f};
    blob_measured_t table = {.azimuths = 1, .elevations = 1, .isotropic = 1, .albedo = {0.5f, 0.5f, 0.5f}};
    table.first_azimuth = blob_builder_add(b, BLOB_SECTION_NUMBERS, directions, 2);
    table.first_elevation = table.first_azimuth + 1;
    table.ndf = (blob_grid_t){blob_builder_add(b, BLOB_SECTION_NUMBERS, flat, 4), 2, 2};
    table.sigma = (blob_grid_t){blob_builder_add(b, BLOB_SECTION_NUMBERS, flat, 4), 2, 2};
    table.visible = (blob_grid_t){blob_builder_add(b, BLOB_SECTION_NUMBERS, warp, 10), 2, 2};
    table.luminance = (blob_grid_t){blob_builder_add(b, BLOB_SECTION_NUMBERS, warp, 10), 2, 2};
    table.first_colour = blob_builder_add(b, BLOB_SECTION_NUMBERS, colours, 12);
    blob_builder_add(b, BLOB_SECTION_MEASUREMENTS, &table, 1);
}

/* Materials 0 to 8 are those of the spheres; 9 is the walls', 10 the panel's, 11 the wire's, 12 the floor's,
 * 13 the ceiling's, 14 the hair's. */
enum { SPHERES = 9, WALLS = 9, PANEL = 10, WIRE = 11, FLOOR = 12, CEILING = 13, HAIR = 14, MATERIALS = 15 };

static void add_materials(blob_builder_t *b)
{
    blob_material_t m[MATERIALS] = {{.kind = MATERIAL_DIFFUSE},
                                    {.kind = MATERIAL_DIELECTRIC, .flags = MATERIAL_REMAP_SQRT},
                                    {.kind = MATERIAL_CONDUCTOR, .flags = MATERIAL_REMAP_SQRT},
                                    {.kind = MATERIAL_DISNEY, .flags = MATERIAL_REMAP_V3},
                                    {.kind = MATERIAL_COATED_DIFFUSE, .flags = MATERIAL_REMAP_SQRT},
                                    {.kind = MATERIAL_GLTF, .flags = MATERIAL_REMAP_SQUARE | MATERIAL_THIN},
                                    {.kind = MATERIAL_MIX, .parts = {0, 2}},
                                    {.kind = MATERIAL_DIELECTRIC},
                                    {.kind = MATERIAL_UBER, .flags = MATERIAL_REMAP_V3},
                                    {.kind = MATERIAL_PHONG, .bump = 2},
                                    {.kind = MATERIAL_GLTF, .flags = MATERIAL_REMAP_SQUARE},
                                    {.kind = MATERIAL_FOURIER},
                                    {.kind = MATERIAL_MEASURED},
                                    {.kind = MATERIAL_WARD_BALANCED},
                                    {.kind = MATERIAL_HAIR}};
    for (uint32_t i = 0; i < MATERIALS; i++) {
        m[i].values[VALUE_REFLECTANCE] = (blob_value_t){{0.8f, 0.7f, 0.6f}, i % 2 == 0 ? 3 : 1, 0};
        m[i].values[VALUE_TRANSMITTANCE] = blob_constant(0.9f);
        m[i].values[VALUE_SPECULAR] = m[i].values[VALUE_OPACITY] = blob_constant(0.6f);
        m[i].values[VALUE_SPECULAR_COLOUR] = blob_constant(1);
        m[i].values[VALUE_ETA] = blob_constant(1.45f);
        m[i].values[VALUE_ROUGHNESS_U] = blob_constant(0.3f);
        m[i].values[VALUE_ROUGHNESS_V] = blob_constant(0.1f);
        m[i].values[VALUE_METALLIC] = m[i].values[VALUE_CLEARCOAT] = blob_constant(0.4f);
        m[i].values[VALUE_CLEARCOAT_GLOSS] = m[i].values[VALUE_SHEEN] = blob_constant(0.5f);
    }
    m[WALLS].values[VALUE_EXPONENT] = blob_constant(30);
    m[0].values[VALUE_SIGMA] = blob_constant(20);
    m[2].values[VALUE_REFLECTANCE] = blob_constant(1);
    m[2].values[VALUE_K] = blob_colour_value(vec3(3.9f, 2.4f, 2.2f));
    m[4].values[VALUE_THICKNESS] = blob_constant(0.02f);
    m[4].values[VALUE_ALBEDO] = blob_constant(0.3f);
    m[5].values[VALUE_TRANSMISSION] = blob_constant(0.3f);
    m[5].values[VALUE_DIFFUSE_TRANSMISSION] = m[5].values[VALUE_IRIDESCENCE] = blob_constant(0.5f);
    m[5].values[VALUE_IRIDESCENCE_ETA] = blob_constant(1.3f);
    m[5].values[VALUE_IRIDESCENCE_THICKNESS] = blob_constant(400);
    m[6].values[VALUE_AMOUNT] = blob_constant(0.4f);
    m[PANEL].values[VALUE_TRANSMISSION] = m[PANEL].values[VALUE_SHEEN_COLOUR] = blob_constant(0.5f);
    m[PANEL].values[VALUE_SHEEN_ROUGHNESS] = m[PANEL].values[VALUE_ANISOTROPIC] = blob_constant(0.5f);
    m[PANEL].values[VALUE_ANISOTROPY_TURN] = blob_colour_value(vec3(0.8f, 0.6f, 0));
    m[PANEL].values[VALUE_DISPERSION] = blob_constant(1);
    m[HAIR].values[VALUE_PHEOMELANIN] = blob_constant(0.5f);
    m[HAIR].values[VALUE_TILT] = blob_constant(2);
    m[7].values[VALUE_ROUGHNESS_U] = m[7].values[VALUE_ROUGHNESS_V] = blob_constant(0);
    blob_builder_add(b, BLOB_SECTION_MATERIALS, m, MATERIALS);
}

static void add_shape(blob_builder_t *b, shape_kind_t kind, uint32_t geometry, uint32_t material,
                      uint32_t light)
{
    blob_shape_t shape = {.kind = kind,
                          .geometry = geometry,
                          .material = material,
                          .light = light,
                          .alpha = blob_constant(1),
                          .shadow_alpha = blob_constant(1)};
    blob_builder_add(b, BLOB_SECTION_SHAPES, &shape, 1);
}

/* A rectangle with corner p and edges u and v. */
static uint32_t add_rectangle(blob_builder_t *b, vec3_t p, vec3_t u, vec3_t v)
{
    const vec3_t positions[] = {p, v_add(p, u), v_add(p, v_add(u, v)), v_add(p, v)};
    static const vec2_t uvs[] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    static const blob_triangle_t triangles[] = {{{0, 1, 2}}, {{0, 2, 3}}};
    blob_mesh_t mesh = {.vertex_count = 4,
                        .first_normal = BLOB_NONE,
                        .first_uv2 = BLOB_NONE,
                        .first_colour = BLOB_NONE,
                        .triangle_count = 2};
    mesh.first_position = blob_builder_add(b, BLOB_SECTION_POSITIONS, positions, 4);
    mesh.first_uv = blob_builder_add(b, BLOB_SECTION_UVS, uvs, 4);
    mesh.first_triangle = blob_builder_add(b, BLOB_SECTION_TRIANGLES, triangles, 2);
    return blob_builder_add(b, BLOB_SECTION_MESHES, &mesh, 1);
}

static uint32_t add_sphere(blob_builder_t *b, float x, float y, float z, float radius)
{
    const blob_quadric_t sphere = {.kind = QUADRIC_SPHERE,
                                   .object_from_quadric = placed(x, y, z),
                                   .radius = radius,
                                   .z_min = -radius,
                                   .z_max = radius,
                                   .phi_max = TWO_PI_F};
    return blob_builder_add(b, BLOB_SECTION_QUADRICS, &sphere, 1);
}

/* The world: a lamp, a wall, floor and ceiling, nine spheres, a wire and a hair; and a moving instance of a
 * small panel. */
static void add_shapes(blob_builder_t *b)
{
    static const blob_curve_point_t points[8] = {
        {-2, 1.2f, -1, 0.1f}, {-1, -0.6f, -1.5f, 0.05f}, {1, 1.6f, -1.5f, 0.05f}, {2, -1, -1, 0.02f},
        {2, 1.2f, -1, 0.05f}, {1, -0.6f, -1.5f, 0.05f},  {-1, 1, -1.5f, 0.04f},   {-2, -1, -1, 0.03f}};
    const blob_curves_t curves[] = {
        {.kind = CURVES_ROUND, .segment_count = 1, .first_normal = BLOB_NONE},
        {.kind = CURVES_FIBRE, .segment_count = 1, .first_point = 4, .first_normal = BLOB_NONE}};
    blob_builder_add(b, BLOB_SECTION_CURVE_POINTS, points, 8);
    blob_builder_add(b, BLOB_SECTION_CURVES, curves, 2);
    add_shape(b, SHAPE_MESH, add_rectangle(b, vec3(-1, 2.9f, -2), vec3(2, 0, 0), vec3(0, 0, 2)), WALLS, 0);
    add_shape(b, SHAPE_MESH, add_rectangle(b, vec3(-4, -3, 2), vec3(8, 0, 0), vec3(0, 6, 0)), WALLS,
              BLOB_NONE);
    add_shape(b, SHAPE_MESH, add_rectangle(b, vec3(-4, -3, 2), vec3(8, 0, 0), vec3(0, 0, -5)), FLOOR,
              BLOB_NONE);
    add_shape(b, SHAPE_MESH, add_rectangle(b, vec3(-4, 3, 2), vec3(8, 0, 0), vec3(0, 0, -5)), CEILING,
              BLOB_NONE);
    for (uint32_t i = 0; i < SPHERES; i++)
        add_shape(b, SHAPE_QUADRIC,
                  add_sphere(b, 1.6f * ((float)(i % 3) - 1), 1.6f * ((float)(i / 3) - 1), 0, 0.7f), i,
                  BLOB_NONE);
    add_shape(b, SHAPE_CURVES, 0, WIRE, BLOB_NONE);
    add_shape(b, SHAPE_CURVES, 1, HAIR, BLOB_NONE);
    uint32_t world = blob_builder_count(b, BLOB_SECTION_SHAPES);
    add_shape(b, SHAPE_MESH,
              add_rectangle(b, vec3(-0.3f, -0.3f, 0), vec3(0.6f, 0, 0.1f), vec3(0, 0.6f, 0.1f)), PANEL,
              BLOB_NONE);
    const blob_object_t objects[] = {{0, world}, {world, 1}};
    const blob_instance_t instance = {1, placed(0.8f, 0.8f, -1), placed(0.7f, 0.9f, -1)};
    blob_builder_add(b, BLOB_SECTION_OBJECTS, objects, 2);
    blob_builder_add(b, BLOB_SECTION_INSTANCES, &instance, 1);
}

static void add_lights(blob_builder_t *b)
{
    blob_light_t lights[] = {
        {.kind = LIGHT_AREA, .flags = LIGHT_TWO_SIDED, .radiance = blob_colour_value(vec3(9, 8, 7))},
        {.kind = LIGHT_SPOT, .radiance = blob_colour_value(vec3(20, 25, 30)), .parameters = {0.7f, 0.9f}},
        {.kind = LIGHT_DISTANT, .radiance = blob_colour_value(vec3(0.4f, 0.3f, 0.2f))},
        {.kind = LIGHT_INFINITE,
         .radiance = blob_colour_value(vec3(0.5f, 0.6f, 0.9f)),
         .image = 1,
         .mapping = LIGHT_LATLONG}};
    for (size_t i = 0; i < ARRAY_LENGTH(lights); i++) lights[i].world_from_light = xform_identity();
    lights[1].world_from_light = placed(0.5f, 0.5f, -4);
    blob_builder_add(b, BLOB_SECTION_LIGHTS, lights, ARRAY_LENGTH(lights));
}

static result_t make_blob(uint8_t **bytes, uint64_t *size)
{
    blob_builder_t *b = blob_builder_new();
    add_scene(b);
    add_textures(b);
    add_materials(b);
    add_fourier(b);
    add_measured(b);
    add_shapes(b);
    add_lights(b);
    result_t result = blob_builder_finish(b, bytes, size);
    blob_builder_destroy(&b);
    return result;
}

/* ---- the hash ------------------------------------------------------------------------------------------ */

/* What the parts of the fingerprint add up to, piece by piece. */
typedef struct {
    hash_t so_far, piece;
} chain_t;

static void chain_add(chain_t *chain, const void *data, size_t size)
{
    chain->piece = hash_bytes(data, size);
    chain->so_far = hash_bytes(chain, sizeof *chain);
}

static void add_render(chain_t *chain, const renderer_t *renderer, const job_settings_t *settings)
{
    unit_result_t result = {0};
    atomic_bool cancel = false;
    for (uint32_t tile = 0; tile < job_tile_count(settings); tile++) {
        unit_t unit = {tile, 0, settings->spp};
        renderer_unit(renderer, &unit, &result, &cancel);
        for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
            if (result.sums[k].count > 0)
                chain_add(chain, result.sums[k].values, result.sums[k].count * sizeof(int64_t));
        for (size_t i = 0; i < result.splat_count; i++)
            for (int c = 0; c < 3; c++) {
                int64_t value = film_quantise(result.splats[i].rgb[c], settings->film_scale);
                chain_add(chain, &value, sizeof value);
            }
        chain_add(chain, &result.counts.dropped, sizeof result.counts.dropped);
    }
    unit_result_free(&result);
}

/* The C library's functions that the renderer uses. */
static void add_functions(chain_t *chain)
{
    float (*const singles[])(float) = {sinf, cosf, expf, logf, acosf, log1pf, expm1f};
    double (*const doubles[])(double) = {sin, cos, tan, exp, log};
    struct {
        float f[ARRAY_LENGTH(singles) + 2];
        double d[ARRAY_LENGTH(doubles) + 2];
    } values;
    memset(&values, 0, sizeof values);
    for (int i = 1; i <= POINTS; i++) {
        double x = i * 0.00381966, y = 1 - 0.0007 * i; /* x up to 7.8; acos takes at most 1 */
        size_t f = ARRAY_LENGTH(singles), d = ARRAY_LENGTH(doubles);
        for (size_t k = 0; k < f; k++) values.f[k] = singles[k](singles[k] == acosf ? (float)y : (float)x);
        for (size_t k = 0; k < d; k++) values.d[k] = doubles[k](x);
        values.f[f] = atan2f((float)y, (float)x);
        values.f[f + 1] = powf((float)x, 2.4f);
        values.d[d] = atan2(y, x);
        values.d[d + 1] = pow(x, 2.2);
        chain_add(chain, &values, sizeof values);
    }
}

result_t renderer_fingerprint(hash_t *hash)
{
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    renderer_t *renderer;
    TRY(make_blob(&bytes, &size));
    result_t result = blob_open(bytes, size, &blob);
    if (result.code == RESULT_OK) {
        job_settings_t settings = blob_default_settings(&blob);
        settings.width = settings.height = settings.tile_size = RESOLUTION;
        settings.spp = SAMPLES;
        settings.learn = false; /* all samples are one unit */
        result = renderer_new(&blob, &settings, &renderer);
        if (result.code == RESULT_OK) {
            chain_t chain = {{{0}}, {{0}}};
            chain_add(&chain, LIGHTMILL_VERSION, sizeof LIGHTMILL_VERSION);
            add_render(&chain, renderer, &settings);
            add_functions(&chain);
            *hash = chain.so_far;
            renderer_destroy(&renderer);
        }
        blob_close(&blob);
    }
    free(bytes);
    return result;
}
