/* What the glTF importer makes of a scene: geometry, hierarchy, materials, textures, lights, cameras, and
 * what it says to files that are wrong. */
#include "tests/unit/client/import/test_import.h"

#include "common/base.h"
#include "worker/render/light/light.h"
#include "worker/render/texture/texture.h"

/* 2 x 2 texels: red, green; blue, grey 188 with alpha 51 */
#define PNG_URI                                                                                              \
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAFklEQVR4nGP4z8DwHwyB9P89e/"       \
    "YYAwBGoQ"                                                                                               \
    "hi2ARC4gAAAABJRU5ErkJggg=="

/* A unit square facing +z, in all the ways in which glTF can store it. */
typedef struct {
    float positions[4][3], normals[4][3], uvs[4][2];
    uint16_t indices[6], pad;
    uint8_t pad2[2], colours[4][4];
    int16_t quantized[4][4];
    uint8_t sparse_index, pad3[3];
    float sparse_value[3], translations[3][3];
} square_t;

static const square_t square = {
    .positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}},
    .normals = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}},
    .uvs = {{0, 1}, {1, 1}, {1, 0}, {0, 0}},
    .indices = {0, 1, 2, 0, 2, 3},
    .colours = {{255, 0, 0, 255}, {0, 255, 0, 128}, {0, 0, 255, 255}, {255, 255, 255, 0}},
    .quantized = {{0, 0, 0, 9}, {32767, 0, 0, 9}, {32767, 32767, 0, 9}, {0, 32767, -32768, 9}},
    .sparse_index = 2,
    .sparse_value = {2, 3, 0},
    .translations = {{0, 0, 0}, {5, 0, 0}, {0, 5, 0}},
};

/* accessors: 0 positions, 1 normals, 2 uvs, 3 indices, 4 colours, 5 quantized and 6 sparse positions,
 * 7 translations, 8 zeroes */
static const char arrays[] =
    "\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"b%%20b.bin\",\"byteLength\":%zu}],"
    "\"bufferViews\":["
    "{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":48},"
    "{\"buffer\":0,\"byteOffset\":96,\"byteLength\":32},{\"buffer\":0,\"byteOffset\":128,\"byteLength\":12},"
    "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":16},"
    "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":32,\"byteStride\":8},"
    "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":1},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":12},"
    "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":36}],"
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
    "{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
    "{\"bufferView\":2,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},"
    "{\"bufferView\":3,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"},"
    "{\"bufferView\":4,\"componentType\":5121,\"normalized\":true,\"count\":4,\"type\":\"VEC4\"},"
    "{\"bufferView\":5,\"componentType\":5122,\"normalized\":true,\"count\":4,\"type\":\"VEC3\"},"
    "{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":1,"
    "\"indices\":{\"bufferView\":6,\"componentType\":5121},\"values\":{\"bufferView\":7}}},"
    "{\"bufferView\":8,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
    "{\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"}]";

#define CAMERA                                                                                               \
    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5,\"aspectRatio\":2}},"              \
    "{\"type\":\"orthographic\",\"orthographic\":{\"xmag\":3,\"ymag\":4,\"znear\":0,\"zfar\":9}}],"
#define MESH(attributes)                                                                                     \
    "\"meshes\":[{\"name\":\"sq\",\"primitives\":[{\"attributes\":{" attributes "},\"indices\":3,"
#define LAMP "\"materials\":[{\"emissiveFactor\":[1,0.5,0]}],"

/* Imports a scene of the arrays above and `rest`: further properties of the root. */
static void run(bench_t *bench, const char *rest)
{
    char *head = mem_printf(arrays, sizeof square, offsetof(square_t, colours), offsetof(square_t, quantized),
                            offsetof(square_t, sparse_index), offsetof(square_t, sparse_value),
                            offsetof(square_t, translations));
    char *text = mem_printf("{%s,%s}", head, rest);
    bench_write(bench, "b b.bin", &square, sizeof square);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    free(head);
    free(text);
}

/* One square of the given material, without lights and cameras. */
static void run_material(bench_t *bench, const char *attributes, const char *material)
{
    char *rest =
        mem_printf("\"materials\":[{\"name\":\"m\",%s}],\"meshes\":[{\"primitives\":[{\"attributes\":{%s},"
                   "\"indices\":3,\"material\":0}]}],\"nodes\":[{\"mesh\":0}],"
                   "\"textures\":[{\"source\":0},{\"source\":0,\"sampler\":0}],"
                   "\"samplers\":[{\"magFilter\":9728,\"wrapS\":33071,\"wrapT\":33648}],"
                   "\"images\":[{\"uri\":\"" PNG_URI "\"}]",
                   material, attributes);
    run(bench, rest);
    free(rest);
}

#define POSITION "\"POSITION\":0"
#define FULL POSITION ",\"NORMAL\":1,\"TEXCOORD_0\":2"

static blob_value_t value_of(const bench_t *bench, material_value_t value)
{
    return bench->blob.materials[bench->blob.shapes[0].material].values[value];
}

/* ---- the seed scenes ----------------------------------------------------------------------------------- */

/* Blender's z-up space as glTF's y-up. */
static vec3_t turned(vec3_t p)
{
    return vec3(p.x, p.z, -p.y);
}

static void expect_same_vec3(vec3_t a, vec3_t b)
{
    expect_vec3(a, (double)b.x, (double)b.y, (double)b.z);
}

static void measure(const scene_blob_t *blob, bool turn, vec3_t *low, vec3_t *high, double *area)
{
    *low = vec3(1e9f, 1e9f, 1e9f), *high = vec3(-1e9f, -1e9f, -1e9f), *area = 0;
    for (uint64_t m = 0; m < blob->counts[BLOB_SECTION_MESHES]; ++m) {
        const blob_mesh_t *mesh = &blob->meshes[m];
        for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
            vec3_t p[3];
            for (int k = 0; k < 3; ++k) {
                p[k] = blob->positions[mesh->first_position + blob->triangles[mesh->first_triangle + i].v[k]];
                if (turn) p[k] = turned(p[k]);
                *low = vec3(fminf(low->x, p[k].x), fminf(low->y, p[k].y), fminf(low->z, p[k].z));
                *high = vec3(fmaxf(high->x, p[k].x), fmaxf(high->y, p[k].y), fmaxf(high->z, p[k].z));
            }
            *area += 0.5 * (double)v_length(v_cross(v_sub(p[1], p[0]), v_sub(p[2], p[0])));
        }
    }
}

static void expect_same_camera(const blob_scene_t *gltf, const blob_scene_t *pbrt)
{
    assert_int_equal(gltf->camera, CAMERA_PERSPECTIVE);
    assert_int_equal(gltf->width, 1280);
    assert_int_equal(gltf->height, 1280);
    assert_int_equal(gltf->spp, 64);
    assert_int_equal(gltf->max_depth, 8);
    assert_int_equal(gltf->integrator, INTEGRATOR_BDPT);
    assert_int_equal(gltf->sampler, SAMPLER_SOBOL);
    expect_near((double)gltf->fov, (double)pbrt->fov, 1e-4);
    const vec3_t points[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (size_t i = 0; i < ARRAY_LENGTH(points); ++i)
        expect_same_vec3(xform_point(&gltf->world_from_camera, points[i]),
                         turned(xform_point(&pbrt->world_from_camera, points[i])));
}

/* The area light of a world of meshes by the height of its first vertex: where it is and what it emits. */
static void expect_same_lights(const scene_blob_t *gltf, const scene_blob_t *pbrt)
{
    uint64_t count = pbrt->counts[BLOB_SECTION_LIGHTS];
    assert_int_equal(gltf->counts[BLOB_SECTION_LIGHTS], count);
    for (uint64_t i = 0; i < count; ++i) {
        const blob_light_t *a = &gltf->lights[i], *b = &pbrt->lights[i];
        const blob_mesh_t *x = &gltf->meshes[gltf->shapes[a->shape].geometry],
                          *y = &pbrt->meshes[pbrt->shapes[b->shape].geometry];
        expect_same_vec3(a->radiance.factor, b->radiance.factor);
        expect_near((double)gltf->positions[x->first_position].y,
                    (double)pbrt->positions[y->first_position].z, 1e-5);
        assert_int_equal(a->flags, 0); /* although doubleSided: Blender exports nearly all so */
    }
}

static void the_seed_scenes_are_read(void **state)
{
    (void)state;
    static const char *const names[] = {"seed-diffuse", "seed-specular", "seed-hidden"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        bench_t gltf = {0}, pbrt = {0};
        char *path = mem_printf("scenes/%s/%s.glb", names[i], names[i]),
             *twin = mem_printf("scenes/%s", names[i]);
        bench_import(&gltf, path);
        bench_import(&pbrt, twin);
        bench_expect_ok(&gltf);
        bench_expect_ok(&pbrt);
        assert_int_equal(gltf.warning_count, 1);
        expect_text(gltf.warnings, "nothing lights the scene but its own surfaces");
        vec3_t low[2], high[2];
        double area[2];
        measure(&gltf.blob, false, &low[0], &high[0], &area[0]);
        measure(&pbrt.blob, true, &low[1], &high[1], &area[1]);
        expect_same_vec3(low[0], low[1]);
        expect_same_vec3(high[0], high[1]);
        expect_near(area[0], area[1], 1e-3 * area[1]);
        assert_int_equal(gltf.blob.counts[BLOB_SECTION_TRIANGLES], pbrt.blob.counts[BLOB_SECTION_TRIANGLES]);
        expect_same_camera(gltf.blob.scene, pbrt.blob.scene);
        expect_same_lights(&gltf.blob, &pbrt.blob);
        free(path);
        free(twin);
        bench_close(&gltf);
        bench_close(&pbrt);
    }
}

/* ---- geometry ------------------------------------------------------------------------------------------ */

static void a_square_becomes_two_triangles(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, CAMERA LAMP MESH(
                    FULL ",\"TEXCOORD_1\":2,\"COLOR_0\":4") "\"material\":0}]}],"
                                                            "\"nodes\":[{\"mesh\":0},{\"camera\":0}],"
                                                            "\"scene\":0,\"scenes\":[{\"nodes\":[0,1]}]");
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "nothing lights the scene but its own surfaces that emit");
    const blob_mesh_t *mesh = mesh_of(&bench, 0);
    assert_int_equal(mesh->triangle_count, 2);
    assert_int_equal(mesh->vertex_count, 4);
    expect_vec3(positions_of(&bench, 0)[2], 1, 1, 0);
    expect_vec3(bench.blob.normals[mesh->first_normal + 3], 0, 0, 1);
    expect_near((double)bench.blob.uvs[mesh->first_uv].x, 0, 0);
    expect_near((double)bench.blob.uvs[mesh->first_uv].y, 0, 0); /* 1 - v */
    assert_true(mesh->first_uv2 != BLOB_NONE && mesh->first_uv2 != mesh->first_uv);
    const blob_colour_t *c = &bench.blob.colours[mesh->first_colour + 1];
    expect_near((double)c->g, 1, 0);
    expect_near((double)c->a, 128 / 255.0, 1e-6);
    expect_vec3(bench.blob.lights[0].radiance.factor, 1, 0.5, 0);
    assert_int_equal(bench.blob.lights[0].flags, 0); /* not doubleSided */
    assert_int_equal(bench.blob.shapes[0].light, 0);
    bench_close(&bench);
}

static void quantized_and_sparse_accessors_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, LAMP MESH("\"POSITION\":5") "\"material\":0},{\"attributes\":{\"POSITION\":6},\"indices\":3,"
                                            "\"material\":0}]}],\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_vec3(positions_of(&bench, 0)[1], 1, 0, 0);
    expect_vec3(positions_of(&bench, 0)[3], 0, 1, -1);
    expect_vec3(positions_of(&bench, 1)[2], 2, 3, 0);
    expect_vec3(positions_of(&bench, 1)[1], 1, 0, 0);
    assert_int_equal(mesh_of(&bench, 1)->first_normal, BLOB_NONE);
    bench_close(&bench);
}

static void strips_and_fans_become_triangles(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, LAMP "\"meshes\":[{\"primitives\":[{\"attributes\":{" POSITION "},\"mode\":6},"
                     "{\"attributes\":{" POSITION "},\"mode\":5},"
                     "{\"attributes\":{" POSITION "},\"mode\":1}]}],\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "meshes[0].primitives[2]: points and lines");
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 2);
    const vec3_t *p = bench.blob.positions;
    const blob_mesh_t *fan = mesh_of(&bench, 0), *strip = mesh_of(&bench, 1);
    assert_int_equal(fan->triangle_count, 2);
    assert_int_equal(strip->triangle_count, 2);
    const blob_triangle_t *t = bench.blob.triangles + fan->first_triangle;
    for (int i = 0; i < 2; ++i) { /* both triangles of the fan face +z */
        const vec3_t *v = p + fan->first_position;
        vec3_t n = v_cross(v_sub(v[t[i].v[1]], v[t[i].v[0]]), v_sub(v[t[i].v[2]], v[t[i].v[0]]));
        expect_vec3(n, 0, 0, 1);
    }
    t = bench.blob.triangles + strip->first_triangle;
    p += strip->first_position; /* the second one: vertices 1 3 2 */
    expect_vec3(p[t[1].v[0]], 1, 0, 0);
    expect_vec3(p[t[1].v[1]], 0, 1, 0);
    expect_vec3(p[t[1].v[2]], 1, 1, 0);
    bench_close(&bench);
}

static void nodes_multiply_their_transforms(void **state)
{
    (void)state;
    bench_t bench = {0};
    /* a quarter turn about y (z to x), then mirrored in x and moved up */
    run(&bench, LAMP MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"children\":[1],"
                                    "\"matrix\":[-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,10,0,1]},"
                                    "{\"mesh\":0,\"rotation\":[0,0.70710678,0,0.70710678],\"scale\":[2,3,1],"
                                    "\"translation\":[0,0,5]}],\"scenes\":[{\"nodes\":[0]}]");
    bench_expect_ok(&bench);
    expect_vec3(positions_of(&bench, 0)[0], 0, 10, 5);
    expect_vec3(positions_of(&bench, 0)[1], 0, 10, 3); /* x (scaled by 2) points along -z */
    expect_vec3(positions_of(&bench, 0)[3], 0, 13, 5);
    assert_int_equal(bench.blob.shapes[0].flags, SHAPE_FLIP);
    bench_close(&bench);
}

static void nodes_of_one_mesh_become_instances(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, LAMP "\"meshes\":[{\"primitives\":[{\"attributes\":{" POSITION "}},"
                     "{\"attributes\":{" POSITION "},\"indices\":3,\"material\":0}]}],"
                     "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[7,0,0]},"
                     "{\"mesh\":0,\"scale\":[1,1,1e-11]}]");
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_OBJECTS), 2);
    assert_int_equal(count_of(&bench, BLOB_SECTION_INSTANCES), 2);
    assert_int_equal(bench.blob.objects[0].shape_count, 4); /* three lamps, and what is flattened */
    assert_int_equal(bench.blob.objects[1].shape_count, 1);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 3);
    expect_near((double)bench.blob.instances[1].world_from_object.m[0][3], 7, 0);
    bench_close(&bench);
}

static void gpu_instancing_becomes_instances(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0,\"translation\":[1,1,1],\"extensions\":{"
                       "\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":7}}}}]");
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_INSTANCES), 3);
    expect_near((double)bench.blob.instances[1].world_from_object.m[0][3], 6, 1e-6);
    bench_close(&bench);
}

/* ---- materials and textures ---------------------------------------------------------------------------- */

static void no_material_is_the_default_one(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    const blob_material_t *m = &bench.blob.materials[bench.blob.shapes[0].material];
    assert_int_equal(m->kind, MATERIAL_GLTF);
    assert_int_equal(m->flags, MATERIAL_REMAP_SQUARE | MATERIAL_THIN);
    expect_vec3(value_of(&bench, VALUE_REFLECTANCE).factor, 1, 1, 1);
    expect_vec3(value_of(&bench, VALUE_METALLIC).factor, 1, 1, 1);
    expect_vec3(value_of(&bench, VALUE_ROUGHNESS_U).factor, 1, 1, 1);
    expect_vec3(value_of(&bench, VALUE_ETA).factor, 1.5, 1.5, 1.5);
    expect_vec3(value_of(&bench, VALUE_SPECULAR).factor, 1, 1, 1);
    expect_vec3(value_of(&bench, VALUE_SPECULAR_COLOUR).factor, 1, 1, 1);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 1, 0);
    bench_close(&bench);
}

static void extensions_of_materials_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(
        &bench, FULL,
        "\"pbrMetallicRoughness\":{\"metallicFactor\":0.25,\"roughnessFactor\":0.5},"
        "\"emissiveFactor\":[1,1,0.5],\"doubleSided\":true,"
        "\"extras\":{\"lightmill_two_sided\":1},\"extensions\":{"
        "\"KHR_materials_emissive_strength\":{\"emissiveStrength\":8},\"KHR_materials_ior\":{\"ior\":1.3},"
        "\"KHR_materials_transmission\":{\"transmissionFactor\":0.75},"
        "\"KHR_materials_volume\":{\"thicknessFactor\":1,\"attenuationDistance\":2,"
        "\"attenuationColor\":[1,0.5,0]},"
        "\"KHR_materials_specular\":{\"specularFactor\":0.5,\"specularColorFactor\":[1,2,3]},"
        "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.4,\"clearcoatRoughnessFactor\":0.1}}");
    bench_expect_ok(&bench);
    expect_near((double)value_of(&bench, VALUE_METALLIC).factor.x, 0.25, 1e-6);
    expect_near((double)value_of(&bench, VALUE_ROUGHNESS_U).factor.x, 0.5, 1e-6);
    expect_near((double)value_of(&bench, VALUE_ETA).factor.x, 1.3, 1e-6);
    expect_near((double)value_of(&bench, VALUE_TRANSMISSION).factor.x, 0.75, 1e-6);
    expect_vec3(value_of(&bench, VALUE_ATTENUATION).factor, 0, log(2) / 2, log(1e6) / 2);
    expect_near((double)value_of(&bench, VALUE_SPECULAR).factor.x, 0.5, 1e-6);
    expect_vec3(value_of(&bench, VALUE_SPECULAR_COLOUR).factor, 1, 2, 3);
    expect_near((double)value_of(&bench, VALUE_CLEARCOAT).factor.x, 0.4, 1e-6);
    expect_near((double)value_of(&bench, VALUE_CLEARCOAT_ROUGHNESS).factor.x, 0.1, 1e-6);
    assert_int_equal(bench.blob.materials[0].flags, MATERIAL_REMAP_SQUARE);
    expect_vec3(bench.blob.lights[0].radiance.factor, 8, 8, 4);
    assert_int_equal(bench.blob.lights[0].flags, LIGHT_TWO_SIDED);
    bench_close(&bench);
}

/* The coat of a base whose normals are turned keeps those of the mesh, unless it has a map of its own. */
static void a_coat_has_normals_of_its_own(void **state)
{
    (void)state;
#define COAT "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.5"
    static const struct {
        const char *material;
        bool base, own, flag;
    } cases[] = {
        {"\"extensions\":{" COAT "}}", false, false, false},
        {"\"normalTexture\":{\"index\":0},\"extensions\":{" COAT "}}", true, false, true},
        {"\"extensions\":{" COAT ",\"clearcoatNormalTexture\":{\"index\":0,\"scale\":0.25}}}", false, true,
         true},
        {"\"normalTexture\":{\"index\":0},\"extensions\":{\"KHR_materials_clearcoat\":{"
         "\"clearcoatNormalTexture\":{\"index\":0}}}",
         true, false, false},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        run_material(&bench, FULL, cases[i].material);
        bench_expect_ok(&bench);
        const blob_material_t *m = &bench.blob.materials[0];
        assert_int_equal(m->normal_map != 0, cases[i].base);
        assert_int_equal(m->coat_normal_map != 0, cases[i].own);
        assert_int_equal((m->flags & MATERIAL_COAT_NORMAL) != 0, cases[i].flag);
        if (cases[i].own) expect_near((double)m->coat_normal_scale, 0.25, 0);
        bench_close(&bench);
    }
}

/* Only its colour and its alpha count, and it is no light: the scene gets a sky. */
static void an_unlit_material_is_a_picture(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, FULL,
                 "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.1,0.2,0.3,0.4],\"metallicFactor\":0.5},"
                 "\"emissiveFactor\":[1,1,1],\"normalTexture\":{\"index\":0},\"alphaMode\":\"BLEND\","
                 "\"extensions\":{\"KHR_materials_unlit\":{},"
                 "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1}}");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "the scene has no light: a white sky");
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 2);
    const blob_light_t *light = &bench.blob.lights[bench.blob.shapes[0].light];
    assert_int_equal(light->flags, LIGHT_PICTURE | LIGHT_TWO_SIDED);
    expect_vec3(light->radiance.factor, 0.1, 0.2, 0.3);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0.4, 1e-6);
    for (int i = 0; i < MATERIAL_VALUES; ++i)
        expect_vec3(value_of(&bench, (material_value_t)i).factor, 0, 0, 0);
    assert_int_equal(bench.blob.materials[0].normal_map, 0);
    bench_close(&bench);
}

/* What a value is at the vertex of the mesh whose glTF coordinates are (u, v). */
static rgb_t look(const bench_t *bench, const blob_value_t *value, double u, double v)
{
    textures_t *textures = textures_new(&bench->blob);
    texture_point_t at = {.uv = {(float)u, (float)(1 - v)}, .n = {0, 0, 1}, .colour = {1, 0.5f, 1, 0.5f}};
    at.uv2 = (vec2_t){0.25f, 0.25f};
    rgb_t result = textures_value(textures, value, &at);
    textures_destroy(&textures);
    return result;
}

/* The reflectance at normal incidence is the specular colour; what metallic-roughness says beside it counts
 * no more. */
static void a_glossy_material_keeps_its_numbers(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, FULL,
                 "\"pbrMetallicRoughness\":{\"metallicFactor\":1,\"roughnessFactor\":0.9},\"extensions\":{"
                 "\"KHR_materials_ior\":{\"ior\":1.3},\"KHR_materials_pbrSpecularGlossiness\":{"
                 "\"diffuseFactor\":[0.1,0.2,0.3,0.4],\"specularFactor\":[0.5,0.6,0.7],"
                 "\"glossinessFactor\":0.75}},\"alphaMode\":\"BLEND\"");
    bench_expect_ok(&bench);
    expect_vec3(value_of(&bench, VALUE_REFLECTANCE).factor, 0.1, 0.2, 0.3);
    expect_vec3(value_of(&bench, VALUE_SPECULAR_COLOUR).factor, 0.5, 0.6, 0.7);
    expect_near((double)value_of(&bench, VALUE_SPECULAR).factor.x, 1, 0);
    expect_near((double)value_of(&bench, VALUE_ETA).factor.x, 0, 0);
    expect_near((double)value_of(&bench, VALUE_METALLIC).factor.x, 0, 0);
    expect_near((double)value_of(&bench, VALUE_ROUGHNESS_U).factor.x, 0.25, 1e-6);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0.4, 1e-6);
    run_material(&bench, FULL,
                 "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{\"diffuseTexture\":{\"index\":0},"
                 "\"specularFactor\":[1,0.5,0.5],\"glossinessFactor\":0.5,"
                 "\"specularGlossinessTexture\":{\"index\":0}}},\"alphaMode\":\"BLEND\"");
    bench_expect_ok(&bench);
    blob_value_t colour = value_of(&bench, VALUE_REFLECTANCE),
                 specular = value_of(&bench, VALUE_SPECULAR_COLOUR),
                 roughness = value_of(&bench, VALUE_ROUGHNESS_U), alpha = bench.blob.shapes[0].alpha;
    expect_vec3(look(&bench, &colour, 0.75, 0.25), 0, 1, 0);
    expect_vec3(look(&bench, &specular, 0.25, 0.25), 1, 0, 0);
    expect_near((double)look(&bench, &specular, 0.75, 0.75).y, 0.5 * 0.502886, 1e-4);
    expect_near((double)look(&bench, &roughness, 0.25, 0.25).x, 0.5, 1e-6);
    expect_near((double)look(&bench, &roughness, 0.75, 0.75).x, 1 - 0.5 * 0.2, 1e-6);
    expect_near((double)look(&bench, &alpha, 0.75, 0.75).x, 0.2, 1e-6);
    bench_close(&bench);
}

static void textures_are_read_with_their_samplers(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(
        &bench, FULL ",\"COLOR_0\":4",
        "\"alphaMode\":\"BLEND\",\"normalTexture\":{\"index\":0,\"scale\":0.5},\"pbrMetallicRoughness\":{"
        "\"baseColorFactor\":[0.5,0.5,0.5,0.8],\"baseColorTexture\":{\"index\":1},"
        "\"metallicRoughnessTexture\":{\"index\":0}}");
    bench_expect_ok(&bench);
    blob_value_t colour = value_of(&bench, VALUE_REFLECTANCE), metallic = value_of(&bench, VALUE_METALLIC),
                 roughness = value_of(&bench, VALUE_ROUGHNESS_U), alpha = bench.blob.shapes[0].alpha;
    expect_vec3(look(&bench, &colour, 0.25, 0.25), 0.5, 0, 0); /* times the vertex's colour */
    expect_vec3(look(&bench, &colour, 0.75, 0.25), 0, 0.25, 0);
    expect_vec3(look(&bench, &colour, 0.25, 0.75), 0, 0, 0.5);
    expect_near((double)look(&bench, &colour, 0.75, 0.75).x, 0.5 * 0.502886, 1e-4); /* sRGB 188 */
    expect_vec3(look(&bench, &colour, -7, 0.25), 0.5, 0, 0);                        /* clamped */
    expect_vec3(look(&bench, &colour, 0.25, 1.25), 0, 0, 0.5);                      /* mirrored */
    expect_near((double)look(&bench, &metallic, 0.75, 0.75).x, 188 / 255.0, 1e-6);
    expect_near((double)look(&bench, &metallic, 0.25, 0.75).x, 1, 1e-6);  /* blue */
    expect_near((double)look(&bench, &roughness, 0.75, 0.25).x, 1, 1e-6); /* green */
    expect_near((double)look(&bench, &roughness, 0.25, 0.75).x, 0, 1e-6);
    expect_near((double)look(&bench, &alpha, 0.75, 0.75).x, 0.8 * 0.2 * 0.5, 1e-6);
    const blob_material_t *m = &bench.blob.materials[bench.blob.shapes[0].material];
    expect_near((double)m->normal_scale, 0.5, 0);
    assert_int_not_equal(m->normal_map, 0);
    assert_int_equal(count_of(&bench, BLOB_SECTION_IMAGES), 2);
    assert_int_equal(count_of(&bench, BLOB_SECTION_TEXELS), 4); /* shared */
    bench_close(&bench);
}

/* Lobes of their own; without their textures first, then with them. */
static void extensions_that_scatter_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, FULL,
                 "\"extensions\":{"
                 "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.9,0.6,0.3],\"sheenRoughnessFactor\":0.4},"
                 "\"KHR_materials_anisotropy\":{\"anisotropyStrength\":0.7,\"anisotropyRotation\":0.5},"
                 "\"KHR_materials_iridescence\":{\"iridescenceFactor\":0.8},"
                 "\"KHR_materials_diffuse_transmission\":{\"diffuseTransmissionFactor\":0.25}}");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no light"); /* and no word of the extensions */
    assert_null(strstr(bench.warnings, "KHR_materials"));
    expect_vec3(value_of(&bench, VALUE_SHEEN_COLOUR).factor, 0.9, 0.6, 0.3);
    expect_near((double)value_of(&bench, VALUE_SHEEN_ROUGHNESS).factor.x, 0.4, 1e-6);
    expect_near((double)value_of(&bench, VALUE_ANISOTROPIC).factor.x, 0.7, 1e-6);
    expect_vec3(value_of(&bench, VALUE_ANISOTROPY_DIRECTION).factor, 1, 0.5, 0);
    expect_vec3(value_of(&bench, VALUE_ANISOTROPY_TURN).factor, cos(0.5), sin(0.5), 0);
    expect_near((double)value_of(&bench, VALUE_IRIDESCENCE).factor.x, 0.8, 1e-6);
    expect_near((double)value_of(&bench, VALUE_IRIDESCENCE_ETA).factor.x, 1.3, 1e-6);
    expect_near((double)value_of(&bench, VALUE_IRIDESCENCE_THICKNESS).factor.x, 400, 1e-4);
    expect_near((double)value_of(&bench, VALUE_DIFFUSE_TRANSMISSION).factor.x, 0.25, 1e-6);
    expect_vec3(value_of(&bench, VALUE_TRANSMITTANCE).factor, 1, 1, 1);
    run_material(
        &bench, FULL,
        "\"extensions\":{\"KHR_materials_sheen\":{\"sheenColorFactor\":[1,1,1],"
        "\"sheenColorTexture\":{\"index\":1},\"sheenRoughnessFactor\":1,\"sheenRoughnessTexture\":{"
        "\"index\":1}},\"KHR_materials_anisotropy\":{\"anisotropyStrength\":0.5,\"anisotropyTexture\":{"
        "\"index\":1}},\"KHR_materials_iridescence\":{\"iridescenceFactor\":1,\"iridescenceTexture\":{"
        "\"index\":1},\"iridescenceThicknessTexture\":{\"index\":1}},"
        "\"KHR_materials_diffuse_transmission\":{\"diffuseTransmissionFactor\":1,"
        "\"diffuseTransmissionTexture\":{\"index\":1},\"diffuseTransmissionColorTexture\":{\"index\":1}}}");
    bench_expect_ok(&bench);
    const double grey = 188 / 255.0, linear = 0.502886, clear = 0.2;
    const struct {
        material_value_t value;
        double r, g, b;
    } table[] = {
        {VALUE_SHEEN_COLOUR, linear, linear, linear},
        {VALUE_SHEEN_ROUGHNESS, clear, clear, clear},
        {VALUE_ANISOTROPIC, grey / 2, grey / 2, grey / 2},
        {VALUE_ANISOTROPY_DIRECTION, grey, grey, grey},
        {VALUE_IRIDESCENCE, grey, grey, grey},
        {VALUE_IRIDESCENCE_THICKNESS, 100 + 300 * grey, 100 + 300 * grey, 100 + 300 * grey},
        {VALUE_DIFFUSE_TRANSMISSION, clear, clear, clear},
        {VALUE_TRANSMITTANCE, linear, linear, linear},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(table); i++) {
        blob_value_t value = value_of(&bench, table[i].value);
        rgb_t found = look(&bench, &value, 0.75, 0.75);
        expect_near((double)found.x, table[i].r, 1e-4 * fmax(1, table[i].r));
        expect_near((double)found.y, table[i].g, 1e-4 * fmax(1, table[i].g));
        expect_near((double)found.z, table[i].b, 1e-4 * fmax(1, table[i].b));
    }
    /* What the channels are: at red all but those of red and alpha are 0. */
    blob_value_t strength = value_of(&bench, VALUE_ANISOTROPIC), film = value_of(&bench, VALUE_IRIDESCENCE),
                 thickness = value_of(&bench, VALUE_IRIDESCENCE_THICKNESS);
    expect_near((double)look(&bench, &strength, 0.25, 0.25).x, 0, 0);
    expect_near((double)look(&bench, &film, 0.25, 0.25).x, 1, 0);
    expect_near((double)look(&bench, &thickness, 0.25, 0.25).x, 100, 1e-4);
    expect_near((double)look(&bench, &thickness, 0.75, 0.25).x, 400, 1e-4);
    bench_close(&bench);
}

static void dispersion_is_read_and_a_film_goes_before_it(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, FULL,
                 "\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
                 "\"KHR_materials_volume\":{\"thicknessFactor\":1},"
                 "\"KHR_materials_dispersion\":{\"dispersion\":0.36}}");
    bench_expect_ok(&bench);
    expect_near((double)value_of(&bench, VALUE_DISPERSION).factor.x, 0.36, 1e-6);
    run_material(&bench, FULL,
                 "\"extensions\":{\"KHR_materials_iridescence\":{\"iridescenceFactor\":0.5,"
                 "\"iridescenceIor\":0.5},\"KHR_materials_dispersion\":{\"dispersion\":0.36}}");
    bench_expect_ok(&bench);
    expect_near((double)value_of(&bench, VALUE_DISPERSION).factor.x, 0, 0);
    expect_near((double)value_of(&bench, VALUE_IRIDESCENCE_ETA).factor.x, 1, 0);
    expect_text(bench.warnings, "materials[0] (m).KHR_materials_dispersion: is ignored beside "
                                "KHR_materials_iridescence");
    expect_text(bench.warnings, "iridescenceIor");
    bench_close(&bench);
}

static void masks_and_texture_transforms_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    /* half a texture to the right; then, a quarter turn about the corner: u' = v + 1/2, v' = -u */
    run_material(&bench, FULL,
                 "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.3,\"pbrMetallicRoughness\":{\"baseColorTexture\":{"
                 "\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.5,0]}}}},"
                 "\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{\"index\":0,\"extensions\":{"
                 "\"KHR_texture_transform\":{\"offset\":[0.5,0],\"rotation\":1.57079632679,\"scale\":[1,2],"
                 "\"texCoord\":0}}}");
    bench_expect_ok(&bench);
    blob_value_t colour = value_of(&bench, VALUE_REFLECTANCE), alpha = bench.blob.shapes[0].alpha,
                 emission = bench.blob.lights[0].radiance;
    assert_int_equal(bench.blob.shapes[0].flags, SHAPE_CUTOUT);
    expect_vec3(look(&bench, &colour, 0.25, 0.25), 0, 1, 0);
    expect_near((double)look(&bench, &alpha, 0.25, 0.25).x, 1, 0);
    expect_near((double)look(&bench, &alpha, 0.25, 0.75).x, 0, 0); /* 0.2 is below the cutoff */
    expect_vec3(look(&bench, &emission, 0.75, 0.375), 1, 0, 0);    /* (1.25, -0.75) */
    expect_vec3(look(&bench, &emission, 0.75, 0.125), 0, 1, 0);    /* (0.75, -0.75) */
    expect_vec3(look(&bench, &emission, 0.25, 0.375), 0, 0, 1);    /* (1.25, -0.25) */
    bench_close(&bench);
}

static void second_coordinates_are_used_where_they_are_named(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, FULL,
                 "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"texCoord\":1}}");
    bench_expect_ok(&bench);
    blob_value_t colour = value_of(&bench, VALUE_REFLECTANCE);
    expect_vec3(look(&bench, &colour, 0.75, 0.25), 0, 0, 1); /* uv2 is (1/4, 1 - 3/4) */
    bench_close(&bench);
}

/* Viewers show points and lines, or an empty scene: there is a picture, but nothing on it. */
static void a_scene_may_have_nothing_to_render(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char *const scenes[] = {MESH(POSITION) "\"mode\":0}]}],\"nodes\":[{\"mesh\":0}]",
                                         "\"nodes\":[{}]", "\"scenes\":[]"};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); ++i) {
        bench.strict = false;
        run(&bench, scenes[i]);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, "s.gltf: the scene has no shape that could be rendered");
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 0);
        /* The camera sees a cube about the origin. */
        vec3_t eye = xform_point(&bench.blob.scene->world_from_camera, vec3(0, 0, 0));
        assert_true(v_is_finite(eye) && v_length(eye) > 1.8f && v_length(eye) < 100);
        bench.strict = true;
        run(&bench, scenes[i]);
        assert_int_equal(bench.result.code, RESULT_INPUT);
    }
    bench_close(&bench);
}

static void what_the_mask_hides_is_left_out(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_material(&bench, POSITION,
                 "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.4]}");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no shape that could be rendered");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 0);
    run_material(&bench, POSITION,
                 "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.6]}");
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 1, 0);
    bench_close(&bench);
}

/* ---- lights and cameras -------------------------------------------------------------------------------- */

#define LIGHTS                                                                                               \
    "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\",\"intensity\":683,"            \
    "\"color\":[1,0.5,0]},{\"type\":\"spot\",\"intensity\":2,\"spot\":{\"innerConeAngle\":0.2,"              \
    "\"outerConeAngle\":0.4}},{\"type\":\"directional\",\"intensity\":3}]}},"
#define LIGHT_NODE(n, more) "{\"extensions\":{\"KHR_lights_punctual\":{\"light\":" n "}}" more "}"

static void lights_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, LIGHTS MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}," LIGHT_NODE(
                    "0", ",\"translation\":[1,"
                         "2,3],\"scale\":[0,0,"
                         "0]") "," LIGHT_NODE("1", ",\"rotation\":[0.70710678,0,0,0.70710678],\"scale\":[9,9,"
                                                   "9]") "," LIGHT_NODE("2", "") "]");
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 3);
    const blob_light_t *l = bench.blob.lights;
    assert_int_equal(l[0].kind, LIGHT_POINT);
    expect_vec3(l[0].radiance.factor, 683, 341.5, 0);
    expect_vec3(xform_point(&l[0].world_from_light, vec3(0, 0, 0)), 1, 2, 3);
    assert_int_equal(l[1].kind, LIGHT_SPOT);
    assert_int_equal(l[1].flags, LIGHT_SQUARE);
    expect_near((double)l[1].parameters[0], cos(0.4), 1e-6);
    expect_near((double)l[1].parameters[1], cos(0.2), 1e-6);
    /* a quarter turn about x takes the node's -z to +y */
    expect_vec3(xform_vector(&l[1].world_from_light, vec3(0, 0, 1)), 0, 1, 0);
    assert_int_equal(l[2].kind, LIGHT_DISTANT);
    expect_vec3(l[2].radiance.factor, 3, 3, 3);
    expect_vec3(xform_vector(&l[2].world_from_light, vec3(0, 0, 1)), 0, 0, 1); /* where the light stands */
    bench_close(&bench);
}

/* Animations hide things so. */
static void what_a_scale_of_0_hides_is_left_out(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        LIGHTS MESH(FULL) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"scale\":[0,0,0]},"
                          "{\"scale\":[0,1,1],\"children\":[3]},{\"mesh\":0,\"rotation\":[0,0,"
                          "0.6,0.8],\"scale\":[1,1,0]}," LIGHT_NODE("1", ",\"scale\":[0,0,0]") "," LIGHT_NODE(
                              "2", ",\"scale\":[1,1,0]") "]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "nodes[1]: is scaled to nothing, so its mesh is left out");
    expect_text(bench.warnings, "nodes[3]: is scaled to nothing, so its mesh is left out");
    expect_text(bench.warnings, "nodes[4]: its light has no direction, or lies beyond 1e18, and is left out");
    expect_text(bench.warnings, "nodes[5]: its light has no direction, or lies beyond 1e18, and is left out");
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 1);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1); /* the white sky */
    bench_close(&bench);
}

static void what_a_scale_of_0_flattens_is_drawn_flat(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, LAMP MESH(FULL) "\"material\":0}]}],\"nodes\":[{\"mesh\":0,\"translation\":[0,0,3],"
                                "\"rotation\":[0.70710678,0,0,0.70710678],\"scale\":[2,1,0]}]");
    bench_expect_ok(&bench);
    expect_vec3(positions_of(&bench, 0)[2], 2, 0, 4);
    assert_int_equal(mesh_of(&bench, 0)->first_normal, BLOB_NONE);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1);
    bench_close(&bench);
}

static void nodes_that_are_not_visible_are_left_out(void **state)
{
    (void)state;
#define VISIBLE(word) "\"extensions\":{\"KHR_node_visibility\":{\"visible\":" word "}}"
#define SOME_HIDDEN(word)                                                                                    \
    CAMERA LIGHTS MESH(                                                                                      \
        FULL) "\"mode\":4}]}],\"extensionsRequired\":[\"KHR_node_visibility\"],"                             \
              "\"nodes\":[{\"mesh\":0," VISIBLE("true") "},{\"mesh\":0,\"children\":[2,3,4]," VISIBLE(       \
                  word) "},{\"mesh\":0," VISIBLE("true") "},{\"camera\":0}," LIGHT_NODE("1",                 \
                                                                                        "") ",{\"mesh\":0}]"
    bench_t bench = {0};
    run(&bench, SOME_HIDDEN("false"));
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_INSTANCES), 2);
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_INFINITE); /* the white sky */
    assert_int_equal(bench.warning_count, 1);
    run(&bench, SOME_HIDDEN("true"));
    bench_expect_silence(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_INSTANCES), 4);
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_SPOT);
    run(&bench, SOME_HIDDEN("7"));
    expect_text(bench.result.message, "nodes[1].KHR_node_visibility.visible: must be true or false");
    bench_close(&bench);
}

/* Blender's lamps come in candela at 683 lumens a watt, its emission does not. */
static void lights_of_blender_have_the_right_unit(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        LIGHTS LAMP MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0}," LIGHT_NODE(
            "0", "") "],"
                     "\"asset\":{\"version\":\"2.0\",\"generator\":\"Khronos glTF Blender I/O v4.2.57\"}");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "Unitless");
    expect_vec3(bench.blob.lights[0].radiance.factor, 1, 0.5, 0);
    expect_vec3(bench.blob.lights[1].radiance.factor, 1, 0.5, 0);
    bench_close(&bench);
}

#define GENERATOR(name) "\"asset\":{\"version\":\"2.0\",\"generator\":\"" name "\"}"

/* The intensity of the first light in a direction `degrees` off its axis, seen by the renderer, over its own.
 */
static double share_at(const bench_t *bench, double degrees)
{
    scene_t *scene;
    light_view_t view;
    assert_int_equal(scene_new(&bench->blob, &scene).code, RESULT_OK);
    lights_t *lights = lights_new(scene);
    double angle = degrees * 3.14159265 / 180;
    vec3_t point = xform_point(&bench->blob.lights[0].world_from_light,
                               vec3((float)sin(angle), 0, (float)cos(angle))); /* at a distance of 1 */
    bool lit = lights_illuminate(lights, point, 0.5f, (vec2_t){0.5f, 0.5f}, &view);
    lights_destroy(&lights);
    scene_destroy(&scene);
    return lit ? (double)(view.radiance.x / bench->blob.lights[0].radiance.factor.x) : 0;
}

/* Blender's exporter writes the half angle of a spot and 1 - Blend of it; Cycles' fall-off is a smooth step
 * of the cosine, from that of the half angle to a share Blend of the way to 1. */
static void spots_of_blender_fall_off_as_in_cycles(void **state)
{
    (void)state;
    static const struct {
        const char *generator;
        bool cosine;
    } cases[] = {{GENERATOR("Khronos glTF Blender I/O v3.4.50"), true},
                 {GENERATOR("Khronos glTF Blender I/O v1.8.19"), true},
                 {GENERATOR("Khronos glTF Blender I/O v3.5.30"), false},
                 {GENERATOR("Khronos glTF Blender I/O v4.2.57"), false},
                 {GENERATOR("Khronos glTF Blender I/O"), false}};
    const double half = 0.4, blend = 0.5, rim = cos(half); /* as LIGHTS has it: 0.4, and 0.2 inside */
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        char *rest = mem_printf(LIGHTS MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}," LIGHT_NODE(
                                    "1", ",\"translation\":[9,9,9]") "],%s",
                                cases[i].generator);
        run(&bench, rest);
        bench_expect_ok(&bench);
        for (double degrees = 0; degrees < 25; degrees += 1.7) {
            double c = cos(degrees * 3.14159265 / 180), x = (c - rim) / ((1 - rim) * blend);
            double t = fmin(fmax(x, 0), 1), share = t * t * (3 - 2 * t) * (cases[i].cosine ? c : 1);
            expect_near(share_at(&bench, degrees), share, 2e-5);
        }
        free(rest);
        bench_close(&bench);
    }
}

static void a_node_that_blender_cannot_export_is_told_of(void **state)
{
    (void)state;
    static const struct {
        const char *material, *generator;
        bool told;
    } cases[] = {{"\"pbrMetallicRoughness\":{}", GENERATOR("Khronos glTF Blender I/O v3.4.50"), true},
                 {"\"pbrMetallicRoughness\":{}", GENERATOR("another"), false},
                 {"\"doubleSided\":true", GENERATOR("Khronos glTF Blender I/O v3.4.50"), false},
                 {"\"pbrMetallicRoughness\":{\"metallicFactor\":0}",
                  GENERATOR("Khronos glTF Blender I/O v3.4.50"), false},
                 {"\"pbrMetallicRoughness\":{},\"emissiveFactor\":[1,1,1]",
                  GENERATOR("Khronos glTF Blender I/O v3.4.50"), false}};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *material = mem_printf("%s}],%s,\"x\":[{", cases[i].material, cases[i].generator);
        run_material(&bench, POSITION, material);
        bench_expect_ok(&bench);
        assert_int_equal(strstr(bench.warnings, "node is not a Principled BSDF") != NULL, cases[i].told);
        free(material);
    }
    bench_close(&bench);
}

/* Blender marks nearly all materials as doubleSided; of other programs' files one warning is enough. */
static void area_lamps_that_blender_left_out_are_told_of(void **state)
{
    (void)state;
    static const struct {
        const char *node, *generator;
        bool told;
    } cases[] = {{"\"name\":\"Area\"", "Khronos glTF Blender I/O v4.2.57", true},
                 {"\"name\":\"Area.001\",\"translation\":[1,2,3]", "Khronos glTF Blender I/O v4.2.57", true},
                 {"\"name\":\"Area\"", "another", false},
                 {"\"name\":\"Arena\"", "Khronos glTF Blender I/O v4.2.57", false},
                 {"\"name\":\"Area\",\"mesh\":0", "Khronos glTF Blender I/O v4.2.57", false},
                 {"\"name\":\"Area\",\"children\":[]", "Khronos glTF Blender I/O v4.2.57", false}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        char *rest =
            mem_printf(MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0},{%s},{\"name\":\"Area\"}],"
                                      "\"scenes\":[{\"nodes\":[0,1]}]," GENERATOR("%s"),
                       cases[i].node, cases[i].generator);
        run(&bench, rest);
        bench_expect_ok(&bench);
        assert_int_equal(strstr(bench.warnings, "it looks like an area lamp") != NULL, cases[i].told);
        if (cases[i].told) expect_text(bench.warnings, "(1 in all)");
        free(rest);
        bench_close(&bench);
    }
}

static void a_light_of_images_that_is_not_read_names_the_option(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "\"extensionsUsed\":[\"KHR_environment_map\"]," MESH(
                    POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "KHR_environment_map is ignored; its cube maps are KTX2 files, which are not read: give the "
                "scene its surroundings with --environment");
    bench_close(&bench);
}

static void emission_of_one_side_is_told_of_once(void **state)
{
    (void)state;
    static const char *const generators[] = {GENERATOR("Khronos glTF Blender I/O v3.4.50"),
                                             GENERATOR("another")};
    for (int i = 0; i < 2; ++i) {
        bench_t bench = {0};
        char *rest = mem_printf(
            "%s,\"materials\":[{\"doubleSided\":true,\"emissiveFactor\":[1,1,1]},{\"doubleSided\":true,"
            "\"emissiveFactor\":[1,0,1]}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
            "\"indices\":3,\"material\":0},{\"attributes\":{\"POSITION\":0},\"indices\":3,\"material\":1}]}],"
            "\"nodes\":[{\"mesh\":0}]",
            generators[i]);
        run(&bench, rest);
        bench_expect_ok(&bench);
        const char *first = strstr(bench.warnings, "is double-sided, but its light leaves the front alone");
        assert_int_equal(first != NULL, i);
        if (first) assert_null(strstr(first + 1, "is double-sided"));
        free(rest);
        bench_close(&bench);
    }
}

static void a_camera_can_be_chosen(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, CAMERA LAMP MESH(
                    POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0},{\"name\":\"one\",\"camera\":1,"
                              "\"scale\":[2,2,-2],\"translation\":[0,0,4]},{\"name\":\"two\",\"camera\":0}]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "2 cameras (1: nodes[1] (one), 2: nodes[2] (two)); the first is taken, --camera");
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->camera, CAMERA_ORTHOGRAPHIC);
    expect_near((double)scene->screen_window[0], -3, 0);
    expect_near((double)scene->screen_window[3], 4, 0);
    assert_int_equal(scene->width, 1280);
    assert_int_equal(scene->height, 1707);
    run(&bench, CAMERA LAMP MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0},{\"camera\":0}]");
    bench_expect_ok(&bench);
    scene = bench.blob.scene;
    expect_near((double)scene->fov, 0.5 * 180 / 3.14159265, 1e-4);
    assert_int_equal(scene->height, 640);
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(0, 0, 1)), 0, 0, -1);
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(1, 0, 0)), 1, 0, 0);
    bench_close(&bench);
}

#define TWO_CAMERAS                                                                                          \
    CAMERA LAMP MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0,\"name\":\"square\"},"             \
                               "{\"name\":\"one\",\"camera\":1},"                                            \
                               "{\"name\":\"two\",\"camera\":0,\"translation\":[0,0,4]}]"

/* Imports a file of two cameras with the wishes; the result is the bench's. */
static void run_view(bench_t *bench, const import_wishes_t *wishes)
{
    bench->wishes = wishes;
    run(bench, TWO_CAMERAS);
}

static void another_camera_can_be_asked_for(void **state)
{
    (void)state;
    static const struct {
        const char *camera;
        camera_kind_t kind;
    } cases[] = {{"2", CAMERA_PERSPECTIVE},
                 {"two", CAMERA_PERSPECTIVE},
                 {"1", CAMERA_ORTHOGRAPHIC},
                 {"one", CAMERA_ORTHOGRAPHIC}};
    static const char *const none[] = {"0", "3", "two ", "-1", "", "2x"};
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        wishes.camera = cases[i].camera;
        run_view(&bench, &wishes);
        bench_expect_ok(&bench);
        assert_int_equal(bench.blob.scene->camera, cases[i].kind);
        assert_null(strstr(bench.warnings, "cameras"));
    }
    for (size_t i = 0; i < ARRAY_LENGTH(none); ++i) {
        wishes.camera = none[i];
        run_view(&bench, &wishes);
        assert_int_equal(bench.result.code, RESULT_USAGE);
        expect_text(bench.result.message, "it has 2: 1: nodes[1] (one), 2: nodes[2] (two)");
    }
    wishes.camera = "2";
    bench_run_v3(&bench, "");
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--camera is for files with several cameras");
    bench_close(&bench);
}

/* Three squares: the first has a material of its own in both variants, the second in one of them. */
#define VARIANTS(mapping)                                                                                    \
    "\"extensions\":{\"KHR_materials_variants\":{\"variants\":[{\"name\":\"beach\"},{\"name\":"              \
    "\"\\u001b2\"}]}},\"materials\":[{\"name\":\"a\",\"emissiveFactor\":[1,1,1]},{\"name\":\"b\"},"          \
    "{\"name\":\"c\"}],\"meshes\":[{\"primitives\":["                                                        \
    "{\"attributes\":{" POSITION "},\"material\":0,\"extensions\":{\"KHR_materials_variants\":{"             \
    "\"mappings\":[{\"variants\":[1],\"material\":1}," mapping "]}}},"                                       \
    "{\"attributes\":{" POSITION "},\"material\":0,\"extensions\":{\"KHR_materials_variants\":{"             \
    "\"mappings\":[{\"variants\":[0,1],\"material\":2}]}}},"                                                 \
    "{\"attributes\":{" POSITION "},\"material\":0}]}],\"nodes\":[{\"mesh\":0}]"

/* The first letters of the materials' names. */
static void expect_looks(bench_t *bench, const char *names)
{
    run(bench, VARIANTS("{\"variants\":[0],\"material\":2}"));
    bench_expect_ok(bench);
    for (int i = 0; i < 3; ++i) {
        const blob_material_t *material = &bench->blob.materials[bench->blob.shapes[i].material];
        assert_int_equal((bench->blob.strings + material->name)[0], names[i]);
    }
}

static void a_variant_can_be_asked_for(void **state)
{
    (void)state;
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    bench.wishes = &wishes;
    expect_looks(&bench, "aaa");
    expect_text(bench.warnings,
                "the scene has 2 variants (1: beach, 2: ?2); its materials are taken as they");
    wishes.variant = "beach";
    expect_looks(&bench, "cca");
    assert_null(strstr(bench.warnings, "variants"));
    wishes.variant = "1";
    expect_looks(&bench, "cca");
    wishes.variant = "2";
    expect_looks(&bench, "bca");
    static const char *const unknown[] = {"street", "0", "3", "2x", ""};
    for (size_t i = 0; i < ARRAY_LENGTH(unknown); ++i) {
        wishes.variant = unknown[i];
        run(&bench, VARIANTS("{\"variants\":[0],\"material\":2}"));
        assert_int_equal(bench.result.code, RESULT_USAGE);
        expect_text(bench.result.message, "it has 2: 1: beach, 2: ?2");
    }
    wishes.variant = "2";
    run(&bench, VARIANTS("{\"variants\":[2],\"material\":2}"));
    bench_expect_ok(&bench); /* the mapping before it is taken */
    wishes.variant = "1";
    run(&bench, VARIANTS("{\"variants\":[2],\"material\":2}"));
    expect_text(bench.result.message, "element 0 must be the index of one of the 2 variants");
    run(&bench, VARIANTS("{\"variants\":[0],\"material\":3}"));
    expect_text(bench.result.message, "material: is 3, but there are 3, counted from 0");
    run(&bench, MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]");
    expect_text(bench.result.message, "--variant: the scene has no variant '1'; it has 0");
    bench_close(&bench);
}

static void a_lens_opens_and_focuses(void **state)
{
    (void)state;
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.camera = "two";
    wishes.fov = 33;
    wishes.lens_radius = 0.1;
    run_view(&bench, &wishes);
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--lens-radius needs --focus");
    wishes.focus = "square"; /* which lies at z = 0, the camera at 4 */
    run_view(&bench, &wishes);
    bench_expect_ok(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    expect_near((double)scene->fov, 33, 1e-5);
    expect_near((double)scene->lens_radius, 0.1, 1e-7);
    expect_near((double)scene->focal_distance, 4, 1e-6);
    wishes.focus = "2.5";
    run_view(&bench, &wishes);
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->focal_distance, 2.5, 1e-6);
    static const char *const wrong[] = {"0", "-1", "nan", "inf", "squares", ""};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); ++i) {
        wishes.focus = wrong[i];
        run_view(&bench, &wishes);
        assert_int_equal(bench.result.code, RESULT_USAGE);
        expect_text(bench.result.message, "--focus takes a distance");
    }
    wishes.lens_radius = 0;
    wishes.focus = "1";
    run_view(&bench, &wishes);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "--focus: the camera has no lens");
    wishes.camera = "one"; /* which is orthographic */
    run_view(&bench, &wishes);
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--fov is for perspective cameras");
    wishes.fov = 0;
    wishes.lens_radius = 0.2;
    run_view(&bench, &wishes);
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->lens_radius, 0.2, 1e-7);
    expect_near((double)bench.blob.scene->focal_distance, 1, 0);
    bench_close(&bench);
}

/* A mesh that stands in several places has its own name there; its nodes tell them apart. Its first part is
 * dark and an instance, its second shines and stands in the world. */
static void focus_finds_one_of_several_places(void **state)
{
    (void)state;
    static const struct {
        const char *focus;
        double distance; /* 0: there is none */
    } cases[] = {{"near", 4}, {"far", 9}, {"twin", 0}, {"sq", 0}};
    import_wishes_t wishes = import_wishes_none();
    wishes.lens_radius = 1;
    wishes.camera = "eye";
    bench_t bench = {.wishes = &wishes};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        wishes.focus = cases[i].focus;
        run(&bench, CAMERA LAMP "\"meshes\":[{\"name\":\"sq\",\"primitives\":[{\"attributes\":{" POSITION
                                "}},{\"attributes\":{" POSITION "},\"indices\":3,\"material\":0}]}],"
                                "\"nodes\":[{\"mesh\":0,\"name\":\"near\"},"
                                "{\"mesh\":0,\"name\":\"far\",\"translation\":[0,0,-5]},"
                                "{\"mesh\":0,\"name\":\"twin\"},{\"mesh\":0,\"name\":\"twin\"},"
                                "{\"name\":\"eye\",\"camera\":0,\"translation\":[0,0,4]}]");
        if (cases[i].distance > 0) {
            bench_expect_ok(&bench);
            expect_near((double)bench.blob.scene->focal_distance, cases[i].distance, 1e-5);
        } else {
            assert_int_equal(bench.result.code, RESULT_USAGE);
            expect_text(bench.result.message, i == 2 ? "stands in 2 places" : "stands in 4 places");
        }
    }
    bench_close(&bench);
}

/* In pbrt an object is a shape's place in the file; an instance is found by the shape in it. */
static void focus_finds_shapes_of_all_kinds(void **state)
{
    (void)state;
    static const struct {
        const char *focus;
        double distance; /* 0: there is none */
        const char *message;
    } cases[] = {{"s.pbrt:3", 7, NULL},
                 {"s.pbrt:5", 9, NULL},
                 {"s.pbrt:9", 0, "stands in 2 places"},
                 {"s.pbrt:12", 0, "lies behind the camera"}};
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.lens_radius = 1;
    bench.wishes = &wishes;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        wishes.focus = cases[i].focus;
        bench_run_v3(&bench, "Translate 0 0 7\n"
                             "Shape \"sphere\" \"float radius\" 2\n"
                             "Translate 0 0 1\n"
                             "Shape \"cylinder\" \"float zmin\" 0 \"float zmax\" 2\n"
                             "\n"
                             "\n"
                             "ObjectBegin \"a\"\n"
                             "Shape \"sphere\"\n"
                             "ObjectEnd ObjectInstance \"a\" Translate 1 0 0 ObjectInstance \"a\"\n"
                             "Translate 0 0 -30\n"
                             "Shape \"disk\"\n");
        if (cases[i].distance > 0) {
            bench_expect_ok(&bench);
            expect_near((double)bench.blob.scene->focal_distance, cases[i].distance, 1e-5);
        } else {
            assert_int_equal(bench.result.code, RESULT_USAGE);
            expect_text(bench.result.message, cases[i].message);
        }
    }
    bench_close(&bench);
}

static void a_file_without_light_and_camera_gets_both(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no light");
    expect_text(bench.warnings, "no camera");
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_INFINITE);
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->height, 720);
    /* the middle of the square is in the middle of the image, and its corners are in it */
    xform_t camera_from_world;
    assert_true(xform_invert(&scene->world_from_camera, &camera_from_world));
    vec3_t middle = xform_point(&camera_from_world, vec3(0.5f, 0.5f, 0));
    expect_near((double)middle.x, 0, 1e-5);
    expect_near((double)middle.y, 0, 1e-5);
    assert_true(middle.z > 0);
    for (int i = 0; i < 4; ++i) {
        vec3_t p = xform_point(&camera_from_world, positions_of(&bench, 0)[i]);
        assert_true(fabsf(p.y / p.z) < tanf(scene->fov / 2 * PI_F / 180));
        assert_true(p.z > 0);
    }
    import_wishes_t wishes = import_wishes_none();
    wishes.environment = "1,2,3";
    bench.wishes = &wishes;
    run(&bench, CAMERA MESH(POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0},{\"camera\":0}]");
    bench_expect_silence(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1);
    expect_vec3(bench.blob.lights[0].radiance.factor, 1, 2, 3);
    run(&bench, CAMERA LAMP MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0},{\"camera\":0}]");
    bench_expect_silence(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 2);
    bench_close(&bench);
}

/* ---- files that are wrong ------------------------------------------------------------------------------ */

static void files_that_are_wrong_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *rest, *message;
    } cases[] = {
        {"\"nodes\":[{\"children\":[1]},{\"children\":[0]}],\"scenes\":[{\"nodes\":[0]}]",
         "nodes[0]: is a child of itself"},
        {"\"nodes\":[{\"children\":[2]},{\"children\":[2]},{}],\"scenes\":[{\"nodes\":[0,1]}]",
         "nodes[2]: stands in the scene twice"},
        {"\"nodes\":[{\"children\":[7]}]", "nodes[0].children: element 0 must be the index"},
        {"\"nodes\":[{\"mesh\":1}]", "nodes[0].mesh: is 1, but there are 0"},
        {"\"nodes\":[{\"name\":\"x\",\"matrix\":[1,2]}]", "nodes[0] (x).matrix: must be 16 numbers, found 2"},
        {MESH("\"POSITION\":2") "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]", "must be a VEC3"},
        {MESH("\"POSITION\":0,\"NORMAL\":7") "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "NORMAL has 3 elements for 4"},
        {"\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":7},\"indices\":3}]}],\"nodes\":[{"
         "\"mesh\":0}]",
         "vertex 3, but there are 3"},
        {"\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":0}]}],\"nodes\":[{"
         "\"mesh\":0}]",
         "must be unsigned integers"},
        {"\"scene\":0.5,\"scenes\":[{}]", "scene: must be a whole number"},
        {"\"nodes\":{}", "nodes: must be an array"},
        {"\"cameras\":[{\"type\":\"perspective\"}]," LAMP MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0,\"camera\":0}]",
         "needs perspective.yfov"},
        {"\"asset\":{\"version\":\"1.0\"}", "is not glTF 2.0 but 1.0"},
        {"\"buffers\":[{\"byteLength\":300,\"uri\":\"http://x/y\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "only data: and relative paths"},
        {"\"buffers\":[{\"byteLength\":300,\"uri\":\"b%2\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "is empty or malformed"},
        {"\"buffers\":[{\"byteLength\":300,\"uri\":\"b%20b.bin\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "byteLength says 300"},
        {"\"bufferViews\":[{\"buffer\":0,\"byteOffset\":230,\"byteLength\":48}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "reaches beyond its buffer"},
        {"\"bufferViews\":[{\"buffer\":0,\"byteLength\":47}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "do not fit"},
        {"\"bufferViews\":[{\"buffer\":0,\"byteLength\":48,\"byteStride\":4}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "byteStride 4 is less"},
        {"\"accessors\":[{\"componentType\":5124,\"count\":3,\"type\":\"VEC3\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "componentType 5124"},
        {"\"accessors\":[{\"componentType\":5126,\"count\":4294967290,\"type\":\"VEC3\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "too many for files of"},
        {"\"accessors\":[{\"componentType\":5126,\"count\":4,\"type\":\"MAT3\"}]," MESH(
             POSITION) "\"mode\":4}]}],\"nodes\":[{\"mesh\":0}]",
         "SCALAR, VEC2, VEC3, VEC4 or MAT4"},
        {"\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\",\"sparse\":{"
         "\"count\":1,"
         "\"indices\":{\"bufferView\":6,\"componentType\":5121},\"values\":{\"bufferView\":7}}}]," MESH(
             POSITION) "\"mode\":4}]}],"
                       "\"nodes\":[{\"mesh\":0}]",
         "replaces element 2 of 2"},
        {"\"materials\":[{\"alphaMode\":\"X\"}]," MESH(
             POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0}]",
         "materials[0]: alphaMode \"X\""},
        {"\"materials\":[{\"normalTexture\":{\"index\":0}}],\"textures\":[{\"source\":0}],\"images\":[{"
         "\"uri\":\"no.png\"}]," MESH(POSITION) "\"material\":0}]}],\"nodes\":[{\"mesh\":0}]",
         "images[0]: "},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run(&bench, cases[i].rest);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, "s.gltf: ");
        expect_text(bench.result.message, cases[i].message);
    }
    bench_write(&bench, "s.gltf", "{\n\"asset\": }", 12);
    bench_import_file(&bench, "s.gltf");
    expect_text(bench.result.message, "s.gltf:2:");
    bench_close(&bench);
}

/* A chain of nodes that is too deep must end before the stack does. */
static void a_chain_of_nodes_that_is_too_deep_is_refused(void **state)
{
    (void)state;
    enum { NODES = 100000 };
    bench_t bench = {0};
    char *rest = mem_alloc(NODES * 32 + 100),
         *end = rest + sprintf(rest, "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{}");
    end = rest + sprintf(rest, "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[");
    for (int i = 0; i < NODES; ++i) end += sprintf(end, "{\"children\":[%d]},", i + 1);
    sprintf(end, "{}]");
    run(&bench, rest);
    expect_text(bench.result.message, "nodes deep");
    free(rest);
    bench_close(&bench);
}

/* A .glb of the square with an image and a lamp, as bytes. */
static uint8_t *make_glb(size_t *size)
{
    char *head = mem_printf(arrays, sizeof square, offsetof(square_t, colours), offsetof(square_t, quantized),
                            offsetof(square_t, sparse_index), offsetof(square_t, sparse_value),
                            offsetof(square_t, translations));
    memcpy(strstr(head, "\"uri\":\"b%20b.bin\","), "                  ", 18);
    char *json = mem_printf(
        "{%s," CAMERA LIGHTS "\"materials\":[{\"emissiveFactor\":[1,1,1],\"alphaMode\":\"MASK\","
        "\"pbrMetallicRoughness\":{\"baseColorTexture\":{"
        "\"index\":0}}}],\"textures\":[{\"source\":0,\"sampler\":0}],\"samplers\":[{\"wrapS\":33071}],"
        "\"images\":[{\"uri\":\"" PNG_URI "\"}],\"meshes\":[{\"primitives\":[{\"attributes\":{" FULL
        ",\"COLOR_0\":4},\"indices\":3,\"material\":0},"
        "{\"attributes\":{\"POSITION\":6},\"mode\":5},{\"attributes\":{\"POSITION\":5},\"mode\":6}]}],"
        "\"nodes\":[{\"mesh\":0,\"children\":[1]},{\"mesh\":0,\"camera\":0,\"rotation\":[0,1,0,0]}"
        "," LIGHT_NODE("1", "") "]}",
        head);
    uint32_t length = (uint32_t)strlen(json), padded = (length + 3) / 4 * 4;
    uint32_t header[5] = {0x46546C67, 2, (uint32_t)(28 + padded + sizeof square), padded, 0x4E4F534A};
    uint32_t chunk[2] = {sizeof square, 0x004E4942};
    uint8_t *bytes = mem_alloc(header[2]);
    memset(bytes, ' ', header[2]);
    memcpy(bytes, header, 20);
    memcpy(bytes + 20, json, length);
    memcpy(bytes + 20 + padded, chunk, 8);
    memcpy(bytes + 28 + padded, &square, sizeof square);
    *size = header[2];
    free(head);
    free(json);
    return bytes;
}

/* Damaged files are read or refused, but nothing else happens (the sanitizers watch). */
static void damaged_files_are_read_or_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    size_t size;
    uint8_t *bytes = make_glb(&size), *copy = mem_alloc(size);
    bench_write(&bench, "s.glb", bytes, size);
    bench_import_file(&bench, "s.glb");
    bench_expect_ok(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_INSTANCES), 2);
    uint32_t random = 1;
    int good = 0, refused = 0;
    for (int round = 0; round < 1500; ++round) {
        memcpy(copy, bytes, size);
        for (int k = 0; k < 1 + round % 3; ++k) {
            random = random * 1664525u + 1013904223u;
            size_t at = (random >> 8) % size;
            random = random * 1664525u + 1013904223u;
            copy[at] = copy[at] >= '0' && copy[at] <= '9' ? (uint8_t)('0' + (random >> 24) % 10)
                                                          : (uint8_t)(random >> 24);
        }
        bench_write(&bench, "s.glb", copy, round % 10 == 9 ? size * (size_t)(round % 97) / 97 : size);
        bench_import_file(&bench, "s.glb");
        if (bench.result.code == RESULT_OK)
            ++good;
        else
            ++refused;
    }
    assert_true(good > 100 && refused > 100);
    free(bytes);
    free(copy);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_seed_scenes_are_read),
        cmocka_unit_test(a_square_becomes_two_triangles),
        cmocka_unit_test(quantized_and_sparse_accessors_are_read),
        cmocka_unit_test(strips_and_fans_become_triangles),
        cmocka_unit_test(nodes_multiply_their_transforms),
        cmocka_unit_test(nodes_of_one_mesh_become_instances),
        cmocka_unit_test(gpu_instancing_becomes_instances),
        cmocka_unit_test(no_material_is_the_default_one),
        cmocka_unit_test(extensions_of_materials_are_read),
        cmocka_unit_test(a_coat_has_normals_of_its_own),
        cmocka_unit_test(an_unlit_material_is_a_picture),
        cmocka_unit_test(a_glossy_material_keeps_its_numbers),
        cmocka_unit_test(textures_are_read_with_their_samplers),
        cmocka_unit_test(extensions_that_scatter_are_read),
        cmocka_unit_test(dispersion_is_read_and_a_film_goes_before_it),
        cmocka_unit_test(masks_and_texture_transforms_are_read),
        cmocka_unit_test(second_coordinates_are_used_where_they_are_named),
        cmocka_unit_test(a_scene_may_have_nothing_to_render),
        cmocka_unit_test(what_the_mask_hides_is_left_out),
        cmocka_unit_test(lights_become_ours),
        cmocka_unit_test(nodes_that_are_not_visible_are_left_out),
        cmocka_unit_test(what_a_scale_of_0_hides_is_left_out),
        cmocka_unit_test(what_a_scale_of_0_flattens_is_drawn_flat),
        cmocka_unit_test(lights_of_blender_have_the_right_unit),
        cmocka_unit_test(a_camera_can_be_chosen),
        cmocka_unit_test(another_camera_can_be_asked_for),
        cmocka_unit_test(a_variant_can_be_asked_for),
        cmocka_unit_test(spots_of_blender_fall_off_as_in_cycles),
        cmocka_unit_test(a_node_that_blender_cannot_export_is_told_of),
        cmocka_unit_test(area_lamps_that_blender_left_out_are_told_of),
        cmocka_unit_test(a_light_of_images_that_is_not_read_names_the_option),
        cmocka_unit_test(emission_of_one_side_is_told_of_once),
        cmocka_unit_test(a_lens_opens_and_focuses),
        cmocka_unit_test(focus_finds_one_of_several_places),
        cmocka_unit_test(focus_finds_shapes_of_all_kinds),
        cmocka_unit_test(a_file_without_light_and_camera_gets_both),
        cmocka_unit_test(files_that_are_wrong_are_refused),
        cmocka_unit_test(a_chain_of_nodes_that_is_too_deep_is_refused),
        cmocka_unit_test(damaged_files_are_read_or_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
