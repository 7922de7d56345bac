/* What the pbrt importer makes of a scene: each directive in both dialects. */
#include "common/atomic_file.h"
#include "tests/unit/test_import.h"

#define TRIANGLE "Shape \"trianglemesh\" \"point3 P\" [0 0 0  1 0 0  0 1 0]\n"
#define SPHERE "Shape \"sphere\"\n"

static const blob_shape_t *shape(const bench_t *bench, uint64_t index)
{
    assert_true(index < bench->blob.counts[BLOB_SECTION_SHAPES]);
    return &bench->blob.shapes[index];
}

static const blob_material_t *material_of(const bench_t *bench, uint64_t index)
{
    return &bench->blob.materials[shape(bench, index)->material];
}

static const char *name_of(const bench_t *bench, uint32_t offset)
{
    return bench->blob.strings + offset;
}

/* The world-space image of the origin of the index-th shape, a sphere. */
static vec3_t centre(const bench_t *bench, uint64_t index)
{
    assert_int_equal(shape(bench, index)->kind, SHAPE_SPHERE);
    return xform_point(&bench->blob.spheres[shape(bench, index)->geometry].object_from_sphere, vec3(0, 0, 0));
}

/* ---- the twins ----------------------------------------------------------------------------------------- */

/* Everything but the names, which hold the file's name. */
static void expect_same_scene(const scene_blob_t *a, const scene_blob_t *b)
{
    for (int i = 0; i < BLOB_SECTION_COUNT; ++i)
        if (i != BLOB_SECTION_STRINGS) assert_int_equal(a->counts[i], b->counts[i]);
    assert_memory_equal(a->scene, b->scene, sizeof *a->scene);
    assert_memory_equal(a->positions, b->positions, a->counts[BLOB_SECTION_POSITIONS] * sizeof(vec3_t));
    assert_memory_equal(a->normals, b->normals, a->counts[BLOB_SECTION_NORMALS] * sizeof(vec3_t));
    assert_memory_equal(a->uvs, b->uvs, a->counts[BLOB_SECTION_UVS] * sizeof(vec2_t));
    assert_memory_equal(a->triangles, b->triangles, a->counts[BLOB_SECTION_TRIANGLES] * sizeof *a->triangles);
    assert_memory_equal(a->meshes, b->meshes, a->counts[BLOB_SECTION_MESHES] * sizeof *a->meshes);
    assert_memory_equal(a->spheres, b->spheres, a->counts[BLOB_SECTION_SPHERES] * sizeof *a->spheres);
    assert_memory_equal(a->objects, b->objects, a->counts[BLOB_SECTION_OBJECTS] * sizeof *a->objects);
    assert_memory_equal(a->instances, b->instances, a->counts[BLOB_SECTION_INSTANCES] * sizeof *a->instances);
    assert_memory_equal(a->lights, b->lights, a->counts[BLOB_SECTION_LIGHTS] * sizeof *a->lights);
    for (uint64_t i = 0; i < a->counts[BLOB_SECTION_SHAPES]; ++i) {
        blob_shape_t x = a->shapes[i], y = b->shapes[i];
        x.name = y.name = 0;
        assert_memory_equal(&x, &y, sizeof x);
    }
    for (uint64_t i = 0; i < a->counts[BLOB_SECTION_MATERIALS]; ++i) {
        blob_material_t x = a->materials[i], y = b->materials[i];
        x.name = y.name = 0;
        assert_memory_equal(&x, &y, sizeof x);
    }
}

static void test_scenes_and_their_v4_twins(void **state)
{
    (void)state;
    static const char *const names[] = {"cornell", "caustic"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        bench_t v3 = {0}, v4 = {0};
        char *path = mem_printf("scenes/%s", names[i]),
             *twin = mem_printf("scenes/%s/scene-v4.pbrt", names[i]);
        bench_import(&v3, path);
        bench_import(&v4, twin);
        bench_expect_silence(&v3);
        bench_expect_silence(&v4);
        expect_same_scene(&v3.blob, &v4.blob);
        free(path);
        free(twin);
        bench_close(&v3);
        bench_close(&v4);
    }
}

static void test_seed_scenes(void **state)
{
    (void)state;
    static const struct {
        const char *path;
        int shapes, lights, triangles;
    } scenes[] = {{"scenes/seed-diffuse", 8, 1, 15768},
                  {"scenes/seed-specular/", 8, 1, 15768},
                  {"scenes/seed-hidden/scene.pbrt", 12, 2, 15806}};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); ++i) {
        bench_t bench = {0};
        bench_import(&bench, scenes[i].path);
        bench_expect_silence(&bench);
        const blob_scene_t *scene = bench.blob.scene;
        assert_int_equal(scene->width, 128);
        assert_int_equal(scene->spp, 64);
        assert_int_equal(scene->max_depth, 8);
        assert_int_equal(scene->integrator, INTEGRATOR_BDPT);
        assert_int_equal(scene->sampler, SAMPLER_INDEPENDENT);
        expect_vec3(xform_point(&scene->world_from_camera, vec3(0, 0, 0)), 0, -9.4, 2);
        expect_vec3(xform_vector(&scene->world_from_camera, vec3(0, 0, 1)), 0, 1, 0);
        expect_vec3(xform_vector(&scene->world_from_camera, vec3(1, 0, 0)), 1, 0,
                    0); /* mirrored by Scale -1 1 1 */
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], scenes[i].shapes);
        assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], scenes[i].lights);
        assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], scenes[i].triangles);
        for (uint64_t k = 0; k < bench.blob.counts[BLOB_SECTION_NORMALS]; ++k)
            expect_near((double)v_length(bench.blob.normals[k]), 1, 1e-6);
        bench_close(&bench);
    }
}

static const char world_v3[] =
    "Scale -1 1 1\nLookAt 0 -5 1  0 0 1  0 0 1\n"
    "Camera \"perspective\" \"float fov\" 40\n"
    "Film \"image\" \"integer xresolution\" [64] \"integer yresolution\" [32] \"string filename\" \"a.exr\"\n"
    "PixelFilter \"gaussian\" \"float xwidth\" 1.5 \"float ywidth\" 1.5 \"float alpha\" 2\n"
    "Sampler \"random\" \"integer pixelsamples\" 8\nIntegrator \"path\" \"integer maxdepth\" 3\nWorldBegin\n"
    "MakeNamedMaterial \"gold\" \"string type\" \"metal\" \"rgb eta\" [.14 .37 1.44] \"rgb k\" [4 2.4 1.6]\n"
    "  \"float uroughness\" .2 \"float vroughness\" .1 \"bool remaproughness\" \"false\"\n"
    "Texture \"grey\" \"color\" \"constant\" \"color value\" [.4 .4 .4]\n"
    "ObjectBegin \"o\"\n Material \"matte\" \"texture Kd\" \"grey\"\n Translate 0 0 1\n"
    " Shape \"trianglemesh\" \"integer indices\" [0 1 2 2 1 3] \"point P\" [0 0 0 1 0 0 0 1 0 1 1 0]\n"
    "  \"normal N\" [0 0 1 0 0 2 0 0 1 0 1 1] \"float uv\" [0 0 1 0 0 1 1 1]\nObjectEnd\n"
    "AttributeBegin\n AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] \"rgb scale\" [2 2 2] \"bool twosided\" "
    "[\"true\"]\n"
    " ReverseOrientation\n Shape \"sphere\" \"float radius\" 0.5\nAttributeEnd\n"
    "NamedMaterial \"gold\"\nTransformBegin\n Rotate 30 0 1 0\n ObjectInstance \"o\"\nTransformEnd\n"
    "Shape \"sphere\"\nMaterial \"glass\" \"float eta\" 1.3\nShape \"sphere\" \"float radius\" 2\nWorldEnd\n";

static const char world_v4[] =
    "Option \"string rendercoordsys\" \"world\"\nScale -1 1 1\nLookAt 0 -5 1  0 0 1  0 0 1\n"
    "Camera \"perspective\" \"float fov\" [40]\n"
    "Film \"rgb\" \"integer xresolution\" 64 \"integer yresolution\" 32 \"string filename\" \"a.exr\"\n"
    "PixelFilter \"gaussian\" \"float xradius\" 1.5 \"float yradius\" 1.5 \"float sigma\" 0.5\n"
    "Sampler \"independent\" \"integer pixelsamples\" 8\nIntegrator \"path\" \"integer maxdepth\" "
    "3\nWorldBegin\n"
    "MakeNamedMaterial \"gold\" \"string type\" \"conductor\" \"rgb eta\" [.14 .37 1.44] \"rgb k\" [4 2.4 "
    "1.6]\n"
    "  \"float uroughness\" .2 \"float vroughness\" .1 \"bool remaproughness\" false\n"
    "Texture \"grey\" \"spectrum\" \"constant\" \"rgb value\" [.4 .4 .4]\n"
    "ObjectBegin \"o\"\n Material \"diffuse\" \"texture reflectance\" \"grey\"\n Translate 0 0 1\n"
    " Shape \"trianglemesh\" \"integer indices\" [0 1 2 2 1 3] \"point3 P\" [0 0 0 1 0 0 0 1 0 1 1 0]\n"
    "  \"normal N\" [0 0 1 0 0 2 0 0 1 0 1 1] \"point2 uv\" [0 0 1 0 0 1 1 1]\nObjectEnd\n"
    "AttributeBegin\n AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] \"float scale\" 2 \"bool twosided\" "
    "[true]\n"
    " ReverseOrientation\n Shape \"sphere\" \"float radius\" 0.5\nAttributeEnd\n"
    "NamedMaterial \"gold\"\nTransformBegin\n Rotate 30 0 1 0\n ObjectInstance \"o\"\nTransformEnd\n"
    "Shape \"sphere\"\nMaterial \"dielectric\" \"float eta\" 1.3\nShape \"sphere\" \"float radius\" 2\n";

static void test_the_dialects_mean_the_same(void **state)
{
    (void)state;
    bench_t v3 = {0}, v4 = {0};
    bench_run(&v3, world_v3);
    bench_run(&v4, world_v4);
    bench_expect_silence(&v3);
    bench_expect_ok(&v4);
    expect_text(v4.warnings, "s.pbrt:1:8: parameter \"rendercoordsys\" is ignored");
    expect_same_scene(&v3.blob, &v4.blob);
    /* and both mean this: the world's three spheres come first, then the object's mesh */
    assert_int_equal(v3.blob.counts[BLOB_SECTION_SHAPES], 4);
    assert_int_equal(v3.blob.objects[0].shape_count, 3);
    assert_int_equal(v3.blob.objects[1].first_shape, 3);
    assert_int_equal(v3.blob.instances[0].object, 1);
    expect_near((double)v3.blob.scene->filter.gaussian_sigma, 0.5, 1e-7);
    expect_vec3(v3.blob.lights[0].radiance, 2, 4, 6);
    assert_int_equal(v3.blob.lights[0].flags, LIGHT_TWO_SIDED);
    assert_int_equal(v3.blob.lights[0].shape, 0);
    assert_int_equal(shape(&v3, 0)->flags, SHAPE_FLIP);
    assert_int_equal(material_of(&v3, 0)->kind, MATERIAL_DIFFUSE); /* the default */
    assert_int_equal(material_of(&v3, 1)->kind, MATERIAL_CONDUCTOR);
    assert_string_equal(name_of(&v3, material_of(&v3, 1)->name), "gold");
    assert_int_equal(material_of(&v3, 2)->kind, MATERIAL_DIELECTRIC);
    expect_vec3(material_of(&v3, 3)->reflectance, 0.4, 0.4, 0.4);
    assert_string_equal(name_of(&v3, shape(&v3, 3)->name), "s.pbrt:15");
    expect_vec3(v3.blob.positions[1], 1, 0, 1);
    bench_close(&v3);
    bench_close(&v4);
}

/* ---- defaults and options ------------------------------------------------------------------------------ */

static void test_defaults(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "WorldBegin\n" SPHERE "WorldEnd");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:3:9: the scene has no light");
    const blob_scene_t *v3 = bench.blob.scene;
    assert_int_equal(v3->width, 640);
    assert_int_equal(v3->height, 480);
    assert_int_equal(v3->filter.kind, FILTER_BOX);
    expect_near((double)v3->filter.radius_x, 0.5, 0);
    assert_int_equal(v3->spp, 16);
    assert_int_equal(v3->max_depth, 5);
    expect_near((double)v3->fov, 90, 0);
    expect_vec3(material_of(&bench, 0)->reflectance, 0.5, 0.5, 0.5);

    bench_run(&bench, "WorldBegin\n" SPHERE);
    bench_expect_ok(&bench);
    const blob_scene_t *v4 = bench.blob.scene;
    assert_int_equal(v4->width, 1280);
    assert_int_equal(v4->height, 720);
    assert_int_equal(v4->filter.kind, FILTER_GAUSSIAN);
    expect_near((double)v4->filter.radius_y, 1.5, 0);
    expect_near((double)v4->filter.gaussian_sigma, 0.5, 0);
    bench_close(&bench);
}

static void test_camera(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "Translate 0 0 5\nCamera \"perspective\" \"float halffov\" 20 \"float frameaspectratio\" 2\n"
              "WorldBegin\nCoordSysTransform \"camera\"\n" SPHERE
              "CoordSysTransform \"world\"\nTranslate 1 0 0\n" SPHERE "WorldEnd");
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->fov, 40, 1e-6);
    expect_near((double)bench.blob.scene->screen_window[1], 2, 0);
    expect_near((double)bench.blob.scene->screen_window[2], -1, 0);
    expect_vec3(xform_point(&bench.blob.scene->world_from_camera, vec3(0, 0, 0)), 0, 0, -5);
    expect_vec3(centre(&bench, 0), 0, 0, -5);
    expect_vec3(centre(&bench, 1), 1, 0, 0);

    bench_run(&bench, "Film \"image\" \"integer xresolution\" 100 \"integer yresolution\" 50\n"
                      "Camera \"perspective\" \"float frameaspectratio\" 2 \"float lensradius\" 0\n"
                      "WorldBegin\n" SPHERE "WorldEnd");
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->screen_window[1], 0, 0); /* the film's own aspect: automatic */

    bench_run(&bench, "Camera \"perspective\" \"float screenwindow\" [-1 .5 -.25 .25]\nWorldBegin\n" SPHERE);
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->screen_window[3], 0.25, 0);
    bench_close(&bench);
}

static void test_samplers_and_integrators(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "Sampler \"stratified\" \"integer xsamples\" 3 \"integer ysamples\" 5\n"
              "Integrator \"mlt\" \"integer chains\" 9 \"integer maxdepth\" 1000\nWorldBegin\nWorldEnd");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->spp, 15);
    assert_int_equal(bench.blob.scene->sampler, SAMPLER_SOBOL);
    assert_int_equal(bench.blob.scene->integrator, INTEGRATOR_BDPT);
    assert_int_equal(bench.blob.scene->max_depth, JOB_MAX_DEPTH);
    expect_text(bench.warnings, "s.pbrt:1:1: sampler \"stratified\": the sobol sampler is used instead");
    expect_text(bench.warnings, "s.pbrt:2:1: integrator \"mlt\": bdpt is used instead");
    expect_text(bench.warnings, "s.pbrt:2:18: parameter \"chains\" is ignored");
    expect_text(bench.warnings, "s.pbrt:2:37: maxdepth 1000: 100, the limit, is used");

    bench_run(&bench, "Integrator \"lightpath\"\nSampler \"independent\"\nWorldBegin\n");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->integrator, INTEGRATOR_LIGHT);
    assert_int_equal(bench.blob.scene->spp, 4);
    bench_run(&bench,
              "Integrator \"bdpt\" \"string lightsamplestrategy\" \"power\"\nWorldBegin\n" SPHERE "WorldEnd");
    assert_int_equal(bench.warning_count, 1); /* no light */
    bench_run(&bench, "PixelFilter \"triangle\"\nWorldBegin\n" SPHERE "WorldEnd");
    assert_int_equal(bench.blob.scene->filter.kind, FILTER_TRIANGLE);
    expect_near((double)bench.blob.scene->filter.radius_x, 2, 0);
    bench_close(&bench);
}

/* ---- the graphics state -------------------------------------------------------------------------------- */

static void test_transforms(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "AttributeBegin Translate 1 2 3 Rotate 90 0 0 1 Translate 1 0 0\n" SPHERE "AttributeEnd\n"
                 "Transform [1 0 0 0  0 1 0 0  0 0 1 0  4 5 6 1]\n" SPHERE
                 "ConcatTransform [2 0 0 0  0 2 0 0  0 0 2 0  1 0 0 1]\n" SPHERE
                 "CoordinateSystem \"here\" Identity Scale 2 2 2 ActiveTransform All\n" SPHERE
                 "CoordSysTransform \"here\"\n" SPHERE "TransformBegin Translate 1 0 0\n" SPHERE
                 "TransformEnd\n" SPHERE "Identity LookAt 0 0 5  0 0 0  0 1 0\n" SPHERE);
    bench_expect_ok(&bench);
    expect_vec3(centre(&bench, 0), 1, 3, 3);
    expect_vec3(centre(&bench, 1), 4, 5, 6);
    expect_vec3(centre(&bench, 2), 5, 5, 6);
    expect_vec3(centre(&bench, 3), 0, 0, 0);
    expect_vec3(centre(&bench, 4), 5, 5, 6);
    expect_vec3(centre(&bench, 5), 7, 5, 6);
    expect_vec3(centre(&bench, 6), 5, 5, 6);
    expect_vec3(centre(&bench, 7), 0, 0, 5);
    expect_near((double)bench.blob.spheres[4].object_from_sphere.m[0][0], 2, 0);
    bench_close(&bench);
}

static void test_attributes_are_restored(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Material \"mirror\"\n"
                         "AttributeBegin\n AreaLightSource \"area\" \"rgb L\" [1 1 1]\n Material \"matte\"\n"
                         " ReverseOrientation\n Translate 1 0 0\n" SPHERE "AttributeEnd\n" SPHERE
                         "TransformBegin\n Material \"glass\" Translate 0 0 9\nTransformEnd\n" SPHERE
                         "AreaLightSource \"diffuse\" \"rgb L\" [0 0 0]\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(material_of(&bench, 0)->kind, MATERIAL_DIFFUSE);
    assert_int_equal(shape(&bench, 0)->flags, SHAPE_FLIP);
    assert_int_equal(shape(&bench, 0)->light, 0);
    assert_int_equal(material_of(&bench, 1)->kind, MATERIAL_MIRROR);
    assert_int_equal(shape(&bench, 1)->flags, 0);
    assert_int_equal(shape(&bench, 1)->light, BLOB_NONE);
    expect_vec3(centre(&bench, 1), 0, 0, 0);
    assert_int_equal(material_of(&bench, 2)->kind, MATERIAL_DIELECTRIC); /* TransformEnd keeps the material */
    expect_vec3(centre(&bench, 2), 0, 0, 0);
    assert_int_equal(shape(&bench, 3)->light, BLOB_NONE); /* black is no light */
    bench_close(&bench);
}

static void test_attribute_defaults_of_v4(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "WorldBegin\nAttribute \"shape\" \"float radius\" 3\n" SPHERE "AttributeBegin\n"
                      "Attribute \"shape\" \"float radius\" 4 \"float colour\" 1\n" SPHERE
                      "AttributeEnd\nShape \"sphere\" \"float radius\" 5\n"
                      "Attribute \"light\" \"rgb L\" [7 7 7]\nAreaLightSource \"diffuse\"\n" SPHERE
                      "Attribute \"material\" \"rgb reflectance\" [.1 .2 .3]\nMaterial \"diffuse\"\n" SPHERE);
    bench_expect_ok(&bench);
    static const double radii[] = {3, 4, 5, 3, 3};
    for (int i = 0; i < 5; ++i) expect_near((double)bench.blob.spheres[i].radius, radii[i], 0);
    expect_vec3(bench.blob.lights[0].radiance, 7, 7, 7);
    expect_vec3(material_of(&bench, 4)->reflectance, 0.1, 0.2, 0.3);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:5:36: unused parameter \"float colour\" of Attribute");
    bench_close(&bench);
}

static void test_objects_and_instances(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, SPHERE
                 "ObjectBegin \"a\"\n AreaLightSource \"diffuse\"\n Translate 1 0 0\n" SPHERE
                 "ObjectEnd\n" SPHERE "ObjectBegin \"none\" ObjectEnd\nTranslate 0 0 7\n"
                 "ObjectInstance \"a\"\nScale 1 1 -1\nObjectInstance \"a\"\nObjectInstance \"none\"\n");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_OBJECTS], 3);
    assert_int_equal(bench.blob.objects[0].shape_count, 2);
    assert_int_equal(bench.blob.objects[1].first_shape, 2);
    assert_int_equal(bench.blob.objects[1].shape_count, 1);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 0);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 2);
    expect_vec3(xform_point(&bench.blob.instances[0].world_from_object, vec3(1, 0, 1)), 1, 0, 8);
    expect_vec3(xform_point(&bench.blob.instances[1].world_from_object, vec3(1, 0, 1)), 1, 0, 6);
    expect_vec3(centre(&bench, 2), 1, 0, 0);
    expect_vec3(centre(&bench, 1), 0, 0, 0); /* ObjectEnd restores the state */
    expect_text(bench.warnings, "s.pbrt:6:1: a shape of an object does not emit");
    expect_text(bench.warnings, "the object \"none\" is empty");
    bench_close(&bench);
}

static void test_includes(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *inner = "# a comment\nTranslate 1 0 0\n" SPHERE;
    bench_write(&bench, "inner.pbrt", inner, strlen(inner));
    bench_run_v3(&bench,
                 "AttributeBegin\nInclude \"inner.pbrt\"\nInclude \"inner.pbrt\"\nAttributeEnd\n" SPHERE);
    bench_expect_ok(&bench);
    expect_vec3(centre(&bench, 0), 1, 0, 0);
    expect_vec3(centre(&bench, 1), 2, 0, 0);
    expect_vec3(centre(&bench, 2), 0, 0, 0);
    assert_string_equal(name_of(&bench, shape(&bench, 1)->name), "inner.pbrt:3");
    assert_string_equal(name_of(&bench, shape(&bench, 2)->name), "s.pbrt:6");
    bench_close(&bench);
}

/* Paths are the main file's, as in pbrt; failing that, those of the file that names them. */
static void test_paths_are_resolved(void **state)
{
    (void)state;
    bench_t bench = {0};
    char *folder = bench_path(&bench, "parts"), *deep = bench_path(&bench, "parts/deep.pbrt");
    char *deeper = bench_path(&bench, "parts/deeper.pbrt");
    const char *texts[] = {"Include \"parts/deeper.pbrt\"\nInclude \"deeper.pbrt\"\n", SPHERE};
    char command[300];
    snprintf(command, sizeof command, "mkdir %s", folder);
    assert_int_equal(system(command), 0);
    assert_int_equal(file_write_atomic(deep, texts[0], strlen(texts[0])).code, RESULT_OK);
    assert_int_equal(file_write_atomic(deeper, texts[1], strlen(texts[1])).code, RESULT_OK);
    bench_run_v3(&bench, "Include \"parts/deep.pbrt\"");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SPHERES], 2);
    unlink(deep);
    unlink(deeper);
    rmdir(folder);
    free(folder);
    free(deep);
    free(deeper);
    bench_close(&bench);
}

/* ---- shapes -------------------------------------------------------------------------------------------- */

static void test_orientation(void **state)
{
    (void)state;
    static const struct {
        const char *world;
        uint32_t flags;
    } cases[] = {
        {TRIANGLE, 0},
        {"ReverseOrientation " TRIANGLE, SHAPE_FLIP},
        {"Scale 1 -1 1 " TRIANGLE, SHAPE_FLIP},
        {"ReverseOrientation Scale 1 -1 1 " TRIANGLE, 0},
        {"Scale -1 -1 1 " TRIANGLE, 0},
        {"ReverseOrientation ReverseOrientation " TRIANGLE, 0},
        {SPHERE, 0},
        {"ReverseOrientation " SPHERE, SHAPE_FLIP},
        {"Scale 1 -1 1 " SPHERE, 0}, /* outward stays outward */
        {"ReverseOrientation Scale 1 -1 1 " SPHERE, SHAPE_FLIP},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_run_v3(&bench, cases[i].world);
        bench_expect_ok(&bench);
        assert_int_equal(shape(&bench, 0)->flags, cases[i].flags);
    }
    bench_close(&bench);
}

#define NORMALS "\"normal N\" [0 0 1  1 0 1  0 2 0]"

static void test_vertex_normals(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *mesh = "Shape \"trianglemesh\" \"point P\" [0 0 0 1 0 0 0 1 0] " NORMALS;
    char *stretched = mem_printf("Scale 1 1 2 %s", mesh),
         *reversed = mem_printf("ReverseOrientation %s", mesh);
    char *mirrored = mem_printf("Scale 1 1 -1 %s", mesh);
    bench_run_v3(&bench, stretched);
    bench_expect_ok(&bench);
    expect_vec3(bench.blob.normals[1], 2 / sqrt(5), 0, 1 / sqrt(5));
    expect_vec3(bench.blob.normals[2], 0, 1, 0);
    bench_run_v3(&bench, reversed); /* pbrt turns vertex normals, too */
    expect_vec3(bench.blob.normals[0], 0, 0, -1);
    bench_run_v3(&bench, mirrored);
    expect_vec3(bench.blob.normals[0], 0, 0, -1);
    expect_vec3(bench.blob.normals[2], 0, 1, 0);

    bench_run_v3(&bench,
                 "Shape \"trianglemesh\" \"point P\" [0 0 0 1 0 0 0 1 0] \"normal N\" [1 0 0 0 0 0 1 0 0]");
    bench_expect_ok(&bench);
    expect_vec3(bench.blob.normals[1], 0, 0, 1);
    expect_text(bench.warnings, "s.pbrt:2:1: 1 of 3 vertex normals have no direction");
    free(stretched);
    free(reversed);
    free(mirrored);
    bench_close(&bench);
}

static void test_degenerate_triangles(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Shape \"trianglemesh\" \"point P\" [0 0 0 1 0 0 0 1 0 2 0 0]\n"
                         " \"integer indices\" [0 1 3  0 1 2  1 1 2]\n"
                         "AreaLightSource \"diffuse\"\n"
                         "Shape \"trianglemesh\" \"point P\" [0 0 0 1 1 1 2 2 2]\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 2);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], 1);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 1);
    assert_int_equal(bench.blob.lights[0].shape, 1);
    expect_text(bench.warnings, "s.pbrt:2:1: 2 of 3 triangles have no area");
    expect_text(bench.warnings, "s.pbrt:5:1: 1 of 1 triangles have no area");
    bench_close(&bench);
}

/* ---- materials ----------------------------------------------------------------------------------------- */

static void test_v3_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Material \"mirror\" " SPHERE "Material \"glass\" " SPHERE
                 "Material \"glass\" \"float index\" 1.7 \"rgb Kr\" [.5 .5 .5] \"rgb Kt\" [.2 .3 .4] " SPHERE
                 "Material \"metal\" " SPHERE
                 "Material \"metal\" \"float roughness\" .3 \"float vroughness\" 0 \"bool remaproughness\" "
                 "\"false\" " SPHERE "Material \"matte\" \"xyz Kd\" [.95047 1 1.08883]" SPHERE
                 "Texture \"f\" \"float\" \"constant\" \"float value\" 0\n"
                 "Material \"matte\" \"texture sigma\" \"f\" " SPHERE);
    bench_expect_ok(&bench);
    expect_vec3(material_of(&bench, 0)->reflectance, 0.9, 0.9, 0.9);
    expect_vec3(material_of(&bench, 1)->transmittance, 1, 1, 1);
    expect_near((double)material_of(&bench, 1)->eta.x, 1.5, 0);
    expect_near((double)material_of(&bench, 2)->eta.x, 1.7, 1e-6);
    expect_vec3(material_of(&bench, 2)->transmittance, 0.2, 0.3, 0.4);
    const blob_material_t *copper = material_of(&bench, 3);
    expect_vec3(copper->eta, 0.200438, 0.924033, 1.102212);
    expect_vec3(copper->k, 3.912949, 2.452848, 2.142188);
    double x = log(0.01);
    double alpha =
        1.62142 + 0.819955 * x + 0.1734 * x * x + 0.0171201 * x * x * x + 0.000640711 * x * x * x * x;
    expect_near((double)copper->alpha_u, alpha, 1e-7);
    expect_near((double)material_of(&bench, 4)->alpha_u, 0.3, 1e-7);
    expect_near((double)material_of(&bench, 4)->alpha_v, 1e-3, 1e-9);
    expect_near((double)material_of(&bench, 5)->reflectance.y, 1, 1e-3);
    bench_close(&bench);
}

static void test_v3_shapes_override_their_material(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Material \"matte\" \"rgb Kd\" [.1 .1 .1]\nShape \"sphere\" \"rgb Kd\" [.2 .2 .2]\n" SPHERE
                 "Shape \"sphere\" \"rgb Ks\" [.2 .2 .2]\n");
    bench_expect_ok(&bench);
    expect_vec3(material_of(&bench, 0)->reflectance, 0.2, 0.2, 0.2);
    expect_vec3(material_of(&bench, 1)->reflectance, 0.1, 0.1, 0.1);
    assert_int_equal(shape(&bench, 1)->material, shape(&bench, 2)->material);
    expect_text(bench.warnings, "s.pbrt:5:16: unused parameter \"rgb Ks\" of Shape \"sphere\"");
    bench_close(&bench);
}

static void test_v4_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(
        &bench,
        "WorldBegin\nMaterial \"conductor\" " SPHERE
        "Material \"conductor\" \"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" \"metal-Au-k\" \"float "
        "roughness\" .25 " SPHERE "Material \"conductor\" \"rgb reflectance\" [.5 .2 1] " SPHERE
        "Material \"dielectric\" \"spectrum eta\" \"glass-BK7\" " SPHERE
        "Material \"diffuse\" \"rgb reflectance\" [.5 2 1] " SPHERE);
    bench_expect_ok(&bench);
    expect_near((double)material_of(&bench, 0)->alpha_u, 0, 0);
    expect_vec3(material_of(&bench, 0)->eta, 0.200438, 0.924033, 1.102212);
    expect_near((double)material_of(&bench, 1)->alpha_u, 0.5, 1e-7);
    expect_near((double)material_of(&bench, 1)->k.z, 1.603215, 1e-6);
    const blob_material_t *m =
        material_of(&bench, 2); /* Fresnel at normal incidence gives the reflectance back */
    expect_near((double)(m->k.y * m->k.y / (4 + m->k.y * m->k.y)), 0.2, 1e-6);
    expect_near((double)m->eta.x, 1, 0);
    assert_true(isfinite(m->k.z));
    expect_near((double)material_of(&bench, 3)->eta.x, 1.5168, 1e-6);
    expect_vec3(material_of(&bench, 4)->reflectance, 0.5, 1, 1);
    expect_text(bench.warnings, "s.pbrt:6:20: parameter \"reflectance\" is above 1 and taken for 1");
    bench_close(&bench);
}

static void test_names_have_scopes_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "MakeNamedMaterial \"m\" \"string type\" \"matte\" \"rgb Kd\" [.1 .1 .1]\nAttributeBegin\n"
                 "MakeNamedMaterial \"m\" \"string type\" \"mirror\"\nNamedMaterial \"m\"\n" SPHERE
                 "AttributeEnd\nNamedMaterial \"m\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(material_of(&bench, 0)->kind, MATERIAL_MIRROR);
    assert_int_equal(material_of(&bench, 1)->kind, MATERIAL_DIFFUSE);
    bench_close(&bench);
}

static void test_textures_have_two_name_spaces(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Texture \"t\" \"spectrum\" \"constant\" \"rgb value\" [.1 .2 .3]\n"
                         "Texture \"t\" \"float\" \"constant\" \"float value\" .25\n"
                         "Material \"metal\" \"texture k\" \"t\" \"texture roughness\" \"t\" \"bool "
                         "remaproughness\" \"false\"\n" SPHERE "Texture \"t\" \"float\" \"constant\"\n");
    bench_expect_ok(&bench);
    expect_vec3(material_of(&bench, 0)->k, 0.1, 0.2, 0.3);
    expect_near((double)material_of(&bench, 0)->alpha_v, 0.25, 0);
    expect_text(bench.warnings, "s.pbrt:6:1: the texture \"t\" is replaced");
    bench_close(&bench);
}

/* What no shape wears may be unsupported, but not in silence. */
static void test_unused_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "MakeNamedMaterial \"d\" \"string type\" \"disney\"\n"
                         "Material \"matte\" \"rgb Kdd\" [1 1 1]\nMaterial \"matte\"\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:2:1: a material that no shape has: ");
    expect_text(bench.warnings, "material \"disney\" is not supported yet");
    expect_text(bench.warnings, "s.pbrt:3:18: this material has no parameter \"rgb Kdd\"");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scenes_and_their_v4_twins),
        cmocka_unit_test(test_seed_scenes),
        cmocka_unit_test(test_the_dialects_mean_the_same),
        cmocka_unit_test(test_defaults),
        cmocka_unit_test(test_camera),
        cmocka_unit_test(test_samplers_and_integrators),
        cmocka_unit_test(test_transforms),
        cmocka_unit_test(test_attributes_are_restored),
        cmocka_unit_test(test_attribute_defaults_of_v4),
        cmocka_unit_test(test_objects_and_instances),
        cmocka_unit_test(test_includes),
        cmocka_unit_test(test_paths_are_resolved),
        cmocka_unit_test(test_orientation),
        cmocka_unit_test(test_vertex_normals),
        cmocka_unit_test(test_degenerate_triangles),
        cmocka_unit_test(test_v3_materials),
        cmocka_unit_test(test_v3_shapes_override_their_material),
        cmocka_unit_test(test_v4_materials),
        cmocka_unit_test(test_names_have_scopes_in_v3),
        cmocka_unit_test(test_textures_have_two_name_spaces),
        cmocka_unit_test(test_unused_materials),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
