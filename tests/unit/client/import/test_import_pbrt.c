/* What the pbrt importer makes of a scene: each directive in both dialects. */
#include "common/atomic_file.h"
#include "tests/unit/client/import/test_import.h"
#include "worker/render/texture/texture.h"

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

/* A value of the material of the index-th shape. */
static blob_value_t value_of(const bench_t *bench, uint64_t index, material_value_t slot)
{
    return material_of(bench, index)->values[slot];
}

static rgb_t colour_of(const bench_t *bench, uint64_t index, material_value_t slot)
{
    assert_int_equal(value_of(bench, index, slot).texture, 0);
    return value_of(bench, index, slot).factor;
}

static double number_of(const bench_t *bench, uint64_t index, material_value_t slot)
{
    return (double)colour_of(bench, index, slot).x;
}

static const blob_quadric_t *quadric(const bench_t *bench, uint64_t index)
{
    assert_int_equal(shape(bench, index)->kind, SHAPE_QUADRIC);
    return &bench->blob.quadrics[shape(bench, index)->geometry];
}

/* The world-space image of the origin of the index-th shape, a sphere. */
static vec3_t centre(const bench_t *bench, uint64_t index)
{
    return xform_point(&quadric(bench, index)->object_from_quadric, vec3(0, 0, 0));
}

/* ---- the twins ----------------------------------------------------------------------------------------- */

/* Everything but the names, which hold the file's name, and what v3 has of its own on vertex normals. */
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
    assert_memory_equal(a->quadrics, b->quadrics, a->counts[BLOB_SECTION_QUADRICS] * sizeof *a->quadrics);
    assert_memory_equal(a->textures, b->textures, a->counts[BLOB_SECTION_TEXTURES] * sizeof *a->textures);
    assert_memory_equal(a->images, b->images, a->counts[BLOB_SECTION_IMAGES] * sizeof *a->images);
    assert_memory_equal(a->objects, b->objects, a->counts[BLOB_SECTION_OBJECTS] * sizeof *a->objects);
    assert_memory_equal(a->instances, b->instances, a->counts[BLOB_SECTION_INSTANCES] * sizeof *a->instances);
    assert_memory_equal(a->lights, b->lights, a->counts[BLOB_SECTION_LIGHTS] * sizeof *a->lights);
    for (uint64_t i = 0; i < a->counts[BLOB_SECTION_SHAPES]; ++i) {
        blob_shape_t x = a->shapes[i], y = b->shapes[i];
        x.name = y.name = 0;
        x.flags &= ~(uint32_t)(SHAPE_BUMPS_V3 | SHAPE_NORMALS_V3);
        y.flags &= ~(uint32_t)(SHAPE_BUMPS_V3 | SHAPE_NORMALS_V3);
        assert_memory_equal(&x, &y, sizeof x);
    }
    for (uint64_t i = 0; i < a->counts[BLOB_SECTION_MATERIALS]; ++i) {
        blob_material_t x = a->materials[i], y = b->materials[i];
        x.name = y.name = 0;
        assert_memory_equal(&x, &y, sizeof x);
    }
}

static void scenes_equal_their_v4_twins(void **state)
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

static void the_seed_scenes_are_read(void **state)
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

static void the_dialects_mean_the_same(void **state)
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
    expect_near((double)v3.blob.scene->filter.parameters[0], 0.5, 1e-7);
    expect_vec3(v3.blob.lights[0].radiance.factor, 2, 4, 6);
    assert_int_equal(v3.blob.lights[0].flags, LIGHT_TWO_SIDED);
    assert_int_equal(v3.blob.lights[0].shape, 0);
    assert_int_equal(shape(&v3, 0)->flags, SHAPE_FLIP);
    assert_int_equal(material_of(&v3, 0)->kind, MATERIAL_DIFFUSE); /* the default */
    assert_int_equal(material_of(&v3, 1)->kind, MATERIAL_CONDUCTOR);
    assert_string_equal(name_of(&v3, material_of(&v3, 1)->name), "gold");
    assert_int_equal(material_of(&v3, 2)->kind, MATERIAL_DIELECTRIC);
    expect_vec3(colour_of(&v3, 3, VALUE_REFLECTANCE), 0.4, 0.4, 0.4);
    assert_string_equal(name_of(&v3, shape(&v3, 3)->name), "s.pbrt:15");
    expect_vec3(v3.blob.positions[1], 1, 0, 1);
    bench_close(&v3);
    bench_close(&v4);
}

/* ---- defaults and options ------------------------------------------------------------------------------ */

static void what_is_not_said_has_the_default_of_its_dialect(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "WorldBegin\n" SPHERE "WorldEnd");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:3:9: the scene has no light");
    const blob_scene_t *v3 = bench.blob.scene;
    assert_int_equal(v3->width, 1280);
    assert_int_equal(v3->height, 720);
    assert_int_equal(v3->filter.kind, FILTER_BOX);
    expect_near((double)v3->filter.radius_x, 0.5, 0);
    assert_int_equal(v3->spp, 16);
    assert_int_equal(v3->max_depth, 5);
    expect_near((double)v3->fov, 90, 0);
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.5, 0.5, 0.5);

    bench_run(&bench, "WorldBegin\n" SPHERE);
    bench_expect_ok(&bench);
    const blob_scene_t *v4 = bench.blob.scene;
    assert_int_equal(v4->width, 1280);
    assert_int_equal(v4->height, 720);
    assert_int_equal(v4->filter.kind, FILTER_GAUSSIAN);
    expect_near((double)v4->filter.radius_y, 1.5, 0);
    expect_near((double)v4->filter.parameters[0], 0.5, 0);
    bench_close(&bench);
}

static void a_camera_becomes_that_of_the_blob(void **state)
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

static void samplers_and_integrators_are_read(void **state)
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

static void transforms_are_applied_in_order(void **state)
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
    expect_near((double)quadric(&bench, 4)->object_from_quadric.m[0][0], 2, 0);
    bench_close(&bench);
}

static void attributes_are_restored(void **state)
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

static void attributes_of_v4_give_defaults(void **state)
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
    for (int i = 0; i < 5; ++i) expect_near((double)quadric(&bench, (uint64_t)i)->radius, radii[i], 0);
    expect_vec3(bench.blob.lights[0].radiance.factor, 7, 7, 7);
    expect_vec3(colour_of(&bench, 4, VALUE_REFLECTANCE), 0.1, 0.2, 0.3);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:5:36: unused parameter \"float colour\" of Attribute");
    bench_close(&bench);
}

static void objects_become_instances(void **state)
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

static void included_files_are_read_in_place(void **state)
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
static void paths_begin_at_the_main_file(void **state)
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
    assert_int_equal(bench.blob.counts[BLOB_SECTION_QUADRICS], 2);
    unlink(deep);
    unlink(deeper);
    rmdir(folder);
    free(folder);
    free(deep);
    free(deeper);
    bench_close(&bench);
}

/* ---- shapes -------------------------------------------------------------------------------------------- */

static void orientation_and_mirroring_turn_surfaces_over(void **state)
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
        {"Scale 1 -1 1 " SPHERE, SHAPE_FLIP},
        {"ReverseOrientation Scale 1 -1 1 " SPHERE, 0},
        /* what emits stays outward */
        {"AreaLightSource \"diffuse\" Scale 1 -1 1 " SPHERE, 0},
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

static void vertex_normals_follow_the_surface(void **state)
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

static void degenerate_triangles_are_left_out(void **state)
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

static void v3_materials_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Material \"mirror\" " SPHERE "Material \"glass\" " SPHERE
                 "Material \"glass\" \"float index\" 1.7 \"rgb Kr\" [.5 .5 .5] \"rgb Kt\" [.2 .3 .4] " SPHERE
                 "Material \"metal\" " SPHERE
                 "Material \"metal\" \"float roughness\" .3 \"float vroughness\" 0 \"bool remaproughness\" "
                 "\"false\" " SPHERE "Material \"matte\" \"xyz Kd\" [.95047 1 1.08883]" SPHERE
                 "Texture \"f\" \"float\" \"constant\" \"float value\" 20\n"
                 "Material \"matte\" \"texture sigma\" \"f\" " SPHERE
                 "Material \"glass\" \"float uroughness\" .1 " SPHERE);
    bench_expect_ok(&bench);
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.9, 0.9, 0.9);
    expect_vec3(colour_of(&bench, 1, VALUE_TRANSMITTANCE), 1, 1, 1);
    expect_near(number_of(&bench, 1, VALUE_ETA), 1.5, 0);
    expect_near(number_of(&bench, 1, VALUE_ROUGHNESS_U), 0, 0);
    assert_int_equal(material_of(&bench, 1)->flags, 0); /* smooth: nothing is remapped */
    expect_near(number_of(&bench, 2, VALUE_ETA), 1.7, 1e-6);
    expect_vec3(colour_of(&bench, 2, VALUE_TRANSMITTANCE), 0.2, 0.3, 0.4);
    const double v3_sum = 470.0 / 471; /* the known values of copper, and pbrt-v3's own sum */
    expect_near((double)colour_of(&bench, 3, VALUE_ETA).y, 0.924033 * v3_sum, 1e-4);
    expect_near((double)colour_of(&bench, 3, VALUE_K).x, 3.912949 * v3_sum, 3e-4);
    expect_vec3(colour_of(&bench, 3, VALUE_REFLECTANCE), 1, 1, 1);
    expect_near(number_of(&bench, 3, VALUE_ROUGHNESS_V), 0.01, 1e-7);
    assert_int_equal(material_of(&bench, 3)->flags, MATERIAL_REMAP_V3);
    expect_near(number_of(&bench, 4, VALUE_ROUGHNESS_U), 0.3, 1e-7);
    expect_near(number_of(&bench, 4, VALUE_ROUGHNESS_V), 0, 0);
    assert_int_equal(material_of(&bench, 4)->flags, MATERIAL_ALPHA_V3);
    expect_near((double)colour_of(&bench, 5, VALUE_REFLECTANCE).y, 1, 1e-3);
    expect_near(number_of(&bench, 6, VALUE_SIGMA), 20, 0);
    assert_int_equal(material_of(&bench, 7)->flags, MATERIAL_REMAP_V3);
    bench_close(&bench);
}

typedef struct {
    material_value_t slot;
    double value;
} expected_t;

/* One sphere of the given material: its kind, flags and values; a value that is not listed is 0. */
static void expect_material(const bench_t *bench, uint64_t index, material_kind_t kind, uint32_t flags,
                            const expected_t *expected, size_t count)
{
    assert_int_equal(material_of(bench, index)->kind, kind);
    assert_int_equal(material_of(bench, index)->flags, flags);
    for (int slot = 0; slot < MATERIAL_VALUES; ++slot) {
        double value = 0;
        for (size_t i = 0; i < count; ++i)
            if ((int)expected[i].slot == slot) value = expected[i].value;
        rgb_t c = colour_of(bench, index, (material_value_t)slot);
        if (fabs((double)c.x - value) > 1e-6 || fabs((double)c.y - value) > 1e-6 ||
            fabs((double)c.z - value) > 1e-6)
            fail_msg("shape %d: value %d is (%g %g %g), not %g", (int)index, slot, (double)c.x, (double)c.y,
                     (double)c.z, value);
    }
}

#define EXPECT_MATERIAL(index, kind, flags, expected)                                                        \
    expect_material(&bench, index, kind, flags, expected, ARRAY_LENGTH(expected))

static void v3_materials_have_their_defaults(void **state)
{
    (void)state;
    static const expected_t matte[] = {{VALUE_REFLECTANCE, 0.5}};
    static const expected_t plastic[] = {{VALUE_REFLECTANCE, 0.25},
                                         {VALUE_SPECULAR, 0.25},
                                         {VALUE_ROUGHNESS_U, 0.1},
                                         {VALUE_ROUGHNESS_V, 0.1}};
    static const expected_t substrate[] = {
        {VALUE_REFLECTANCE, 0.5}, {VALUE_SPECULAR, 0.5}, {VALUE_ROUGHNESS_U, 0.1}, {VALUE_ROUGHNESS_V, 0.1}};
    static const expected_t translucent[] = {{VALUE_REFLECTANCE, 0.25}, {VALUE_SPECULAR, 0.25},
                                             {VALUE_REFLECT, 0.5},      {VALUE_TRANSMIT, 0.5},
                                             {VALUE_ROUGHNESS_U, 0.1},  {VALUE_ROUGHNESS_V, 0.1}};
    static const expected_t uber[] = {{VALUE_REFLECTANCE, 0.25}, {VALUE_SPECULAR, 0.25},
                                      {VALUE_OPACITY, 1},        {VALUE_ETA, 1.5},
                                      {VALUE_ROUGHNESS_U, 0.1},  {VALUE_ROUGHNESS_V, 0.1}};
    static const expected_t disney[] = {{VALUE_REFLECTANCE, 0.5},   {VALUE_ETA, 1.5},
                                        {VALUE_ROUGHNESS_U, 0.5},   {VALUE_SHEEN_TINT, 0.5},
                                        {VALUE_CLEARCOAT_GLOSS, 1}, {VALUE_DIFFUSE_TRANSMISSION, 1}};
    static const expected_t other[] = {{VALUE_REFLECTANCE, 0.25}, {VALUE_SPECULAR, 0.25},
                                       {VALUE_MIRROR, 0.125},     {VALUE_TRANSMITTANCE, 0.75},
                                       {VALUE_OPACITY, 0.5},      {VALUE_ETA, 2},
                                       {VALUE_ROUGHNESS_U, 0.2},  {VALUE_ROUGHNESS_V, 0.3}};
    bench_t bench = {0};
    bench_run_v3(&bench, "Material \"matte\" " SPHERE "Material \"plastic\" " SPHERE
                         "Material \"substrate\" " SPHERE "Material \"translucent\" " SPHERE
                         "Material \"uber\" " SPHERE "Material \"disney\" \"bool thin\" \"true\" " SPHERE
                         "Material \"uber\" \"rgb Kr\" [.125 .125 .125] \"rgb Kt\" [.75 .75 .75] \"rgb "
                         "opacity\" [.5 .5 .5] \"float index\" 2 \"float roughness\" .2 \"float vroughness\" "
                         ".3 \"bool remaproughness\" \"false\" " SPHERE);
    bench_expect_ok(&bench);
    EXPECT_MATERIAL(0, MATERIAL_DIFFUSE, 0, matte);
    EXPECT_MATERIAL(1, MATERIAL_PLASTIC, MATERIAL_REMAP_V3, plastic);
    EXPECT_MATERIAL(2, MATERIAL_SUBSTRATE, MATERIAL_REMAP_V3, substrate);
    EXPECT_MATERIAL(3, MATERIAL_TRANSLUCENT, MATERIAL_REMAP_V3, translucent);
    EXPECT_MATERIAL(4, MATERIAL_UBER, MATERIAL_REMAP_V3, uber);
    EXPECT_MATERIAL(5, MATERIAL_DISNEY, MATERIAL_THIN, disney);
    EXPECT_MATERIAL(6, MATERIAL_UBER, 0, other);
    bench_close(&bench);
}

/* Without its own the axis v is as rough as u in pbrt-v3's uber, but not in its metal. */
static void the_roughness_along_u_may_be_that_along_v(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Material \"uber\" \"float uroughness\" .25 " SPHERE
                         "Material \"uber\" \"float vroughness\" .25 \"float roughness\" .5 " SPHERE
                         "Material \"metal\" \"float uroughness\" .25 \"float roughness\" .5 " SPHERE);
    bench_expect_ok(&bench);
    static const double expected[3][2] = {{0.25, 0.25}, {0.5, 0.25}, {0.25, 0.5}};
    for (uint64_t i = 0; i < 3; ++i) {
        expect_near(number_of(&bench, i, VALUE_ROUGHNESS_U), expected[i][0], 0);
        expect_near(number_of(&bench, i, VALUE_ROUGHNESS_V), expected[i][1], 0);
    }
    bench_close(&bench);
}

/* pbrt-v3 looks for numbers alone; a spectrum that is all there is counts here. */
static void a_number_goes_before_a_spectrum_as_an_index(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Material \"glass\" \"spectrum eta\" [400 2 700 2] \"float index\" 1.25 " SPHERE
                         "Material \"glass\" \"spectrum eta\" [400 2 700 2] " SPHERE
                         "Material \"uber\" \"spectrum index\" [400 2 700 2] " SPHERE
                         "Material \"uber\" \"float eta\" 1.75 \"float index\" 1.25 " SPHERE);
    bench_expect_ok(&bench);
    static const double expected[4] = {1.25, 2, 2, 1.75};
    for (uint64_t i = 0; i < 4; ++i) expect_near(number_of(&bench, i, VALUE_ETA), expected[i], 0);
    expect_text(bench.warnings, "s.pbrt:2:18: parameter \"eta\" must be of type float");
    bench_close(&bench);
}

static void v4_materials_have_their_defaults(void **state)
{
    (void)state;
    static const expected_t thin[] = {{VALUE_REFLECTANCE, 1}, {VALUE_TRANSMITTANCE, 1}, {VALUE_ETA, 1.5}};
    static const expected_t coated[] = {{VALUE_REFLECTANCE, 0.5}, {VALUE_ETA, 1.5}, {VALUE_THICKNESS, 0.01}};
    static const expected_t rough[] = {
        {VALUE_REFLECTANCE, 0.5}, {VALUE_ETA, 1.5},         {VALUE_THICKNESS, 0.5},  {VALUE_G, -0.25},
        {VALUE_ALBEDO, 0.75},     {VALUE_ROUGHNESS_U, 0.1}, {VALUE_ROUGHNESS_V, 0.2}};
    static const expected_t metal[] = {{VALUE_ETA, 1.25},
                                       {VALUE_THICKNESS, 0.01},
                                       {VALUE_BASE_ETA, 1},
                                       {VALUE_K, 2}, /* of a reflectance 0.5 */
                                       {VALUE_ROUGHNESS_U, 0},
                                       {VALUE_ROUGHNESS_V, 0},
                                       {VALUE_BASE_ROUGHNESS_U, 0.3},
                                       {VALUE_BASE_ROUGHNESS_V, 0.3}};
    static const expected_t leaf[] = {{VALUE_REFLECTANCE, 0.5}, {VALUE_TRANSMITTANCE, 0.25}};
    static const expected_t dielectric[] = {{VALUE_REFLECTANCE, 1},
                                            {VALUE_TRANSMITTANCE, 1},
                                            {VALUE_ETA, 1.5},
                                            {VALUE_ROUGHNESS_U, 0.5},
                                            {VALUE_ROUGHNESS_V, 0.5}};
    bench_t bench = {0};
    bench_run(
        &bench,
        "WorldBegin\nMaterial \"thindielectric\" " SPHERE "Material \"coateddiffuse\" " SPHERE
        "Material \"coateddiffuse\" \"float thickness\" .5 \"float g\" -.25 \"rgb albedo\" [.75 .75 .75] "
        "\"float uroughness\" .1 \"float vroughness\" .2 \"integer maxdepth\" 3 " SPHERE
        "Material \"coatedconductor\" \"float interface.eta\" 1.25 \"rgb reflectance\" [.5 .5 .5] "
        "\"float conductor.roughness\" .3 \"bool remaproughness\" false " SPHERE
        "Material \"diffusetransmission\" \"rgb reflectance\" [1 1 1] \"rgb transmittance\" [.5 .5 .5] "
        "\"float scale\" .5 " SPHERE "Material \"dielectric\" \"float roughness\" .5 " SPHERE);
    bench_expect_ok(&bench);
    EXPECT_MATERIAL(0, MATERIAL_DIELECTRIC, MATERIAL_THIN, thin);
    EXPECT_MATERIAL(1, MATERIAL_COATED_DIFFUSE, 0, coated);
    EXPECT_MATERIAL(2, MATERIAL_COATED_DIFFUSE, MATERIAL_REMAP_SQRT, rough);
    blob_material_t *m = (blob_material_t *)material_of(&bench, 3);
    expect_near((double)m->values[VALUE_K].factor.y, 2, 1e-6);
    EXPECT_MATERIAL(3, MATERIAL_COATED_CONDUCTOR, 0, metal);
    EXPECT_MATERIAL(4, MATERIAL_DIFFUSE_TRANSMISSION, 0, leaf);
    EXPECT_MATERIAL(5, MATERIAL_DIELECTRIC, MATERIAL_REMAP_SQRT, dielectric);
    bench_close(&bench);
}

#define LIT "LightSource \"point\"\n"
#define STRAND "Shape \"curve\" \"string type\" \"cylinder\" \"point3 P\" [0 0 0  1 0 0  2 0 0  3 0 0]\n"

static void hair_has_its_defaults_in_both_dialects(void **state)
{
    (void)state;
    static const expected_t brown[] = {
        {VALUE_ROUGHNESS_U, 0.3}, {VALUE_ROUGHNESS_V, 0.3}, {VALUE_ETA, 1.55},      {VALUE_TILT, 2},
        {VALUE_ATTENUATION, 0},   {VALUE_EUMELANIN, 1.3},   {VALUE_PHEOMELANIN, 0}, {VALUE_REFLECTANCE, 0}};
    static const expected_t red[] = {{VALUE_ROUGHNESS_U, 0.5},   {VALUE_ROUGHNESS_V, 0.25},
                                     {VALUE_ETA, 1.25},          {VALUE_TILT, -3},
                                     {VALUE_PHEOMELANIN, 0.125}, {VALUE_EUMELANIN, 0.5}};
    static const char pigments[] = "Material \"hair\" \"float pheomelanin\" .125 \"float eumelanin\" .5 "
                                   "\"float beta_m\" .5 \"float beta_n\" "
                                   ".25 \"float alpha\" -3 \"float eta\" 1.25\n" STRAND;
    bench_t bench = {0};
    for (int v3 = 0; v3 < 2; ++v3) {
        char *text =
            mem_printf("%s" LIT "Material \"hair\"\n" STRAND "%s", v3 ? "" : "WorldBegin\n", pigments);
        if (v3)
            bench_run_v3(&bench, text);
        else
            bench_run(&bench, text);
        free(text);
        bench_expect_silence(&bench);
        EXPECT_MATERIAL(0, MATERIAL_HAIR, 0, brown);
        EXPECT_MATERIAL(1, MATERIAL_HAIR, 0, red);
    }
    bench_close(&bench);
}

static void expect_pigments(const bench_t *bench, uint64_t index, uint32_t flags, double sigma, double colour)
{
    assert_int_equal(material_of(bench, index)->kind, MATERIAL_HAIR);
    assert_int_equal(material_of(bench, index)->flags, flags);
    expect_near(number_of(bench, index, VALUE_ATTENUATION), sigma, 1e-6);
    expect_near(number_of(bench, index, VALUE_REFLECTANCE), colour, 1e-6);
    expect_near(number_of(bench, index, VALUE_EUMELANIN), 0, 0);
    expect_near(number_of(bench, index, VALUE_PHEOMELANIN), 0, 0);
}

/* What absorbs: sigma_a goes before a colour, and both before melanin. */
static void hair_absorbs_by_the_first_of_its_pigments(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 LIT "Material \"hair\" \"rgb color\" [.75 .75 .75] \"float eumelanin\" 1 \"rgb sigma_a\" "
                     "[.25 .25 .25]\n" STRAND
                     "Material \"hair\" \"float pheomelanin\" 1 \"rgb color\" [.75 .75 .75]\n" STRAND);
    bench_expect_ok(&bench);
    expect_pigments(&bench, 0, 0, 0.25, 0);
    expect_pigments(&bench, 1, MATERIAL_DYED, 0, 0.75);
    expect_text(bench.warnings, "s.pbrt:3:17: \"color\" is ignored, since there is \"sigma_a\"");
    expect_text(bench.warnings, "\"eumelanin\" is ignored, since there is \"sigma_a\"");
    expect_text(bench.warnings, "\"pheomelanin\" is ignored, since there is \"color\"");
    assert_int_equal(bench.warning_count, 3);
    bench_run(&bench,
              "WorldBegin\n" LIT
              "Material \"hair\" \"float eumelanin\" 1 \"rgb reflectance\" [.75 .75 .75]\n" STRAND
              "Texture \"t\" \"float\" \"fbm\"\nMaterial \"hair\" \"rgb color\" [.75 .75 .75] \"texture "
              "beta_m\" \"t\" \"float beta_n\" 1.5\n" STRAND);
    bench_expect_ok(&bench);
    expect_pigments(&bench, 0, MATERIAL_DYED, 0, 0.75);
    expect_pigments(&bench, 1, MATERIAL_DYED, 0, 0.75);
    assert_int_equal(value_of(&bench, 1, VALUE_ROUGHNESS_U).texture, 1);
    expect_text(bench.warnings, "\"eumelanin\" is ignored, since there is \"reflectance\"");
    expect_text(bench.warnings, "\"beta_n\" is 1.5, and counts as 1, as in pbrt");
    assert_int_equal(bench.warning_count, 2);
    bench_run_v3(&bench, LIT "Material \"hair\" \"float beta_m\" 1.5\n" STRAND);
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, "s.pbrt:3:17: \"beta_m\" is 1.5, but must be from 0 to 1");
    bench_close(&bench);
}

static uint32_t curves_kind(const bench_t *bench, uint64_t index)
{
    assert_int_equal(shape(bench, index)->kind, SHAPE_CURVES);
    return bench->blob.curves[shape(bench, index)->geometry].kind;
}

static void curves_of_hair_are_fibres(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, LIT STRAND
                 "Material \"hair\"\n" STRAND "Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0]\n"
                 "Shape \"curve\" \"string type\" \"ribbon\" \"normal N\" [0 0 1  0 1 0] \"point P\" [0 0 "
                 "0 1 0 0 2 0 0 3 0 0]\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(curves_kind(&bench, 0), CURVES_ROUND);
    assert_int_equal(curves_kind(&bench, 1), CURVES_FIBRE);
    assert_int_equal(curves_kind(&bench, 2), CURVES_FLAT_FIBRE); /* flat ones need no warning then */
    assert_int_equal(curves_kind(&bench, 3), CURVES_RIBBON);
    assert_int_equal(material_of(&bench, 4)->kind, MATERIAL_HAIR);
    /* v4 may say later what it is. */
    bench_run(&bench, "WorldBegin\n" LIT "NamedMaterial \"h\"\n" STRAND "NamedMaterial \"d\"\n" STRAND
                      "MakeNamedMaterial \"h\" \"string type\" \"hair\"\n"
                      "MakeNamedMaterial \"d\" \"string type\" \"diffuse\"\n");
    bench_expect_silence(&bench);
    assert_int_equal(curves_kind(&bench, 0), CURVES_FIBRE);
    assert_int_equal(curves_kind(&bench, 1), CURVES_ROUND);
#define FLAT_STRAND "Shape \"curve\" \"point3 P\" [0 0 0  1 0 0  2 0 0  3 0 0]\n"
    bench_run(&bench, "WorldBegin\n" LIT "NamedMaterial \"h\"\n" FLAT_STRAND
                      "NamedMaterial \"d\"\n" FLAT_STRAND "MakeNamedMaterial \"h\" \"string type\" \"hair\"\n"
                      "MakeNamedMaterial \"d\" \"string type\" \"diffuse\"\n");
    expect_text(bench.warnings, "flat curves are taken for round ones");
    assert_int_equal(curves_kind(&bench, 0), CURVES_FLAT_FIBRE);
    assert_int_equal(curves_kind(&bench, 1), CURVES_ROUND);
    bench_close(&bench);
}

static void mixes_refer_to_their_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "MakeNamedMaterial \"a\" \"string type\" \"mirror\"\n"
                         "MakeNamedMaterial \"b\" \"string type\" \"matte\"\n"
                         "Material \"mix\" \"string namedmaterial1\" \"a\" \"string namedmaterial2\" \"b\" "
                         "\"rgb amount\" [.1 .2 .3]\n" SPHERE);
    bench_expect_ok(&bench);
    const blob_material_t *mix = material_of(&bench, 0);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    expect_vec3(mix->values[VALUE_AMOUNT].factor, 0.1, 0.2, 0.3); /* of the first, which comes second here */
    assert_int_equal(bench.blob.materials[mix->parts[1]].kind, MATERIAL_MIRROR);
    assert_int_equal(bench.blob.materials[mix->parts[0]].kind, MATERIAL_DIFFUSE);

    bench_run(&bench, "WorldBegin\nMaterial \"mix\" \"string materials\" [\"a\" \"b\"] \"float amount\" .75\n"
                      "MakeNamedMaterial \"a\" \"string type\" \"conductor\"\n"
                      "MakeNamedMaterial \"b\" \"string type\" \"diffuse\"\n" SPHERE);
    bench_expect_ok(&bench); /* names that come later are found, too */
    mix = material_of(&bench, 0);
    expect_near((double)mix->values[VALUE_AMOUNT].factor.x, 0.75, 0);
    assert_int_equal(bench.blob.materials[mix->parts[0]].kind, MATERIAL_CONDUCTOR);
    assert_int_equal(bench.blob.materials[mix->parts[1]].kind, MATERIAL_DIFFUSE);
    bench_close(&bench);
}

/* Shapes that only bound media are left out, unless they emit. */
static void shapes_that_only_bound_media_are_left_out(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "WorldBegin\nMaterial \"interface\"\n" SPHERE TRIANGLE "AreaLightSource \"diffuse\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 0);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 0);
    expect_text(bench.warnings, "s.pbrt:2:1: an interface does not emit, as in pbrt");
    bench_run_v3(&bench, "Material \"none\"\n" SPHERE TRIANGLE "AreaLightSource \"diffuse\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    assert_int_equal(shape(&bench, 0)->light, 0);
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0, 0, 0);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:2:1: an interface that emits light is a black surface");
    bench_run_v3(&bench, "Material \"none\"\n" SPHERE "Material \"\"\n" SPHERE "Material \"matte\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    bench_close(&bench);
}

static void a_lenient_import_replaces_what_is_not_supported(void **state)
{
    (void)state;
    bench_t bench = {.lenient = true};
    bench_run(&bench, "WorldBegin\nTexture \"t\" \"float\" \"ptex\" \"string filename\" \"none.ptx\"\n"
                      "Material \"coateddiffuse\" \"texture roughness\" \"t\"\n" SPHERE);
    bench_expect_ok(&bench);
    expect_near(number_of(&bench, 0, VALUE_ROUGHNESS_U), 0.5, 0);
    expect_text(bench.warnings, "s.pbrt:2:1: texture \"ptex\" is not supported; the nearest is");
    bench.lenient = false;
    bench_import_file(&bench, "s.pbrt");
    assert_int_equal(bench.result.code, RESULT_INPUT);
    bench_close(&bench);
}

static void v3_shapes_override_their_material(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Material \"matte\" \"rgb Kd\" [.1 .1 .1]\nShape \"sphere\" \"rgb Kd\" [.2 .2 .2]\n" SPHERE
                 "Shape \"sphere\" \"rgb Ks\" [.2 .2 .2]\n");
    bench_expect_ok(&bench);
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.2, 0.2, 0.2);
    expect_vec3(colour_of(&bench, 1, VALUE_REFLECTANCE), 0.1, 0.1, 0.1);
    assert_int_equal(shape(&bench, 1)->material, shape(&bench, 2)->material);
    expect_text(bench.warnings, "s.pbrt:5:16: unused parameter \"rgb Ks\" of Shape \"sphere\"");
    bench_close(&bench);
}

static void v4_materials_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(
        &bench,
        "WorldBegin\nMaterial \"conductor\" " SPHERE
        "Material \"conductor\" \"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" \"metal-Au-k\" \"float "
        "roughness\" .25 " SPHERE "Material \"conductor\" \"rgb reflectance\" [.5 .2 1] " SPHERE
        "Material \"dielectric\" \"spectrum eta\" \"glass-BK7\" " SPHERE
        "Material \"diffuse\" \"rgb reflectance\" [.5 2 1] " SPHERE
        "Material \"conductor\" \"spectrum eta\" \"metal-Cu-eta\" " SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(material_of(&bench, 0)->flags, 0);
    rgb_t copper = colour_of(&bench, 0, VALUE_ETA), named = colour_of(&bench, 5, VALUE_ETA);
    assert_memory_equal(&copper, &named, sizeof named);
    expect_near((double)copper.x, 0.104494, 1e-5);
    expect_near(number_of(&bench, 1, VALUE_ROUGHNESS_U), 0.25, 1e-7);
    assert_int_equal(material_of(&bench, 1)->flags, MATERIAL_REMAP_SQRT);
    expect_near((double)colour_of(&bench, 1, VALUE_K).z, 1.770893, 1e-5);
    rgb_t k = colour_of(&bench, 2, VALUE_K); /* Fresnel at normal incidence gives the reflectance back */
    expect_near((double)(k.y * k.y / (4 + k.y * k.y)), 0.2, 1e-6);
    expect_near(number_of(&bench, 2, VALUE_ETA), 1, 0);
    assert_true(isfinite(k.z));
    expect_near(number_of(&bench, 3, VALUE_ETA), 1.5168, 1e-5);
    expect_vec3(colour_of(&bench, 4, VALUE_REFLECTANCE), 0.5, 1, 1);
    expect_text(bench.warnings, "s.pbrt:6:20: parameter \"reflectance\" is above 1 and taken for 1");
    bench_close(&bench);
}

static void names_have_scopes_in_v3(void **state)
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

static void textures_have_two_name_spaces(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "Texture \"t\" \"spectrum\" \"constant\" \"rgb value\" [.1 .2 .3]\n"
                         "Texture \"t\" \"float\" \"constant\" \"float value\" .25\n"
                         "Material \"metal\" \"texture k\" \"t\" \"texture roughness\" \"t\" \"bool "
                         "remaproughness\" \"false\"\n" SPHERE "Texture \"t\" \"float\" \"constant\"\n");
    bench_expect_ok(&bench);
    expect_vec3(colour_of(&bench, 0, VALUE_K), 0.1, 0.2, 0.3);
    expect_near(number_of(&bench, 0, VALUE_ROUGHNESS_V), 0.25, 0);
    expect_text(bench.warnings, "s.pbrt:6:1: the texture \"t\" is replaced");
    bench_close(&bench);
}

/* What no shape has may be unsupported, but not in silence. */
static void an_unused_material_may_be_unsupported_but_not_silently(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "MakeNamedMaterial \"i\" \"string type\" \"none\" MakeNamedMaterial \"d\" \"string type\" "
                 "\"mix\" \"string namedmaterial1\" \"i\" \"string namedmaterial2\" \"i\"\n"
                 "Material \"matte\" \"rgb Kdd\" [1 1 1]\nMaterial \"matte\"\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:2:44: a material that no shape has: ");
    expect_text(bench.warnings, "a mix with the interface \"i\" is not supported");
    expect_text(bench.warnings, "s.pbrt:3:18: this material has no parameter \"rgb Kdd\"");
    bench_close(&bench);
}

/* ---- textures ------------------------------------------------------------------------------------------ */

static const blob_texture_t *texture(const bench_t *bench, blob_ref_t ref)
{
    assert_true(ref > 0 && ref <= bench->blob.counts[BLOB_SECTION_TEXTURES]);
    return &bench->blob.textures[ref - 1];
}

/* The texture of the reflectance of the first shape's material. */
static const blob_texture_t *first_texture(const bench_t *bench)
{
    return texture(bench, value_of(bench, 0, VALUE_REFLECTANCE).texture);
}

/* Imports a world whose one sphere is matte (diffuse) with the texture "t" that `texture` makes. */
static void run_texture(bench_t *bench, bool v3, const char *text)
{
    char *world = mem_printf("%s\nMaterial \"%s\" \"texture %s\" \"t\"\n" SPHERE, text,
                             v3 ? "matte" : "diffuse", v3 ? "Kd" : "reflectance");
    char *v4 = mem_printf("WorldBegin\n%s", world);
    if (v3)
        bench_run_v3(bench, world);
    else
        bench_run(bench, v4);
    free(world);
    free(v4);
    bench_expect_ok(bench);
}

static void expect_floats(const float *values, const double *expected, size_t count)
{
    for (size_t i = 0; i < count; ++i) expect_near((double)values[i], expected[i], 1e-6);
}

#define TEXTURE(kind) "Texture \"t\" \"spectrum\" \"" kind "\" "

static void combining_textures_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *dots = "Texture \"d\" \"spectrum\" \"dots\" \"rgb inside\" [.1 .2 .3]\n"
                       "Texture \"f\" \"float\" \"fbm\"\n";
    char *text = mem_printf("%s" TEXTURE("scale") "\"texture tex1\" \"d\" \"rgb tex2\" [.5 1 2]", dots);
    run_texture(&bench, true, text); /* no record: the factor is in the value */
    free(text);
    expect_vec3(value_of(&bench, 0, VALUE_REFLECTANCE).factor, 0.5, 1, 2);
    assert_int_equal(first_texture(&bench)->kind, TEXTURE_DOTS);
    expect_vec3(first_texture(&bench)->inputs[0].factor, 0.1, 0.2, 0.3);
    expect_vec3(first_texture(&bench)->inputs[1].factor, 0, 0, 0);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TEXTURES], 2);

    text = mem_printf("%s" TEXTURE("scale") "\"texture tex\" \"d\" \"texture scale\" \"f\"", dots);
    run_texture(&bench, false, text);
    free(text);
    assert_int_equal(first_texture(&bench)->kind, TEXTURE_SCALE);
    assert_int_equal(texture(&bench, first_texture(&bench)->inputs[0].texture)->kind, TEXTURE_DOTS);
    assert_int_equal(texture(&bench, first_texture(&bench)->inputs[1].texture)->kind, TEXTURE_FBM);

    text = mem_printf("%s" TEXTURE("mix") "\"texture tex2\" \"d\" \"texture amount\" \"f\"", dots);
    run_texture(&bench, true, text);
    free(text);
    assert_int_equal(first_texture(&bench)->kind, TEXTURE_MIX);
    expect_vec3(first_texture(&bench)->inputs[0].factor, 0, 0, 0);
    assert_int_equal(texture(&bench, first_texture(&bench)->inputs[1].texture)->kind, TEXTURE_DOTS);
    assert_int_equal(texture(&bench, first_texture(&bench)->inputs[2].texture)->kind, TEXTURE_FBM);

    run_texture(&bench, false, "Rotate 90 0 0 1\n" TEXTURE("directionmix") "\"rgb tex1\" [.5 .5 .5]");
    const blob_texture_t *t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_DIRECTION_MIX);
    expect_vec3(t->inputs[1].factor, 0.5, 0.5, 0.5); /* the share |n . d| is of tex1 */
    expect_vec3(t->inputs[0].factor, 1, 1, 1);
    expect_floats(t->parameters, (const double[]){-1, 0, 0}, 3);
    bench_close(&bench);
}

static void patterns_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_texture(&bench, true, TEXTURE("bilerp") "\"rgb v10\" [.1 .2 .3]");
    const blob_texture_t *t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_BILERP);
    static const double corners[] = {0, 1, 0.1, 1};
    for (int i = 0; i < 4; ++i) expect_near((double)t->inputs[i].factor.x, corners[i], 1e-6);
    run_texture(&bench, true, TEXTURE("uv"));
    assert_int_equal(first_texture(&bench)->kind, TEXTURE_UV);
    run_texture(&bench, true, TEXTURE("checkerboard") "\"string aamode\" \"none\" \"rgb tex2\" [.5 .5 .5]");
    t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_CHECKERBOARD);
    assert_int_equal(t->mapping, MAPPING_UV);
    expect_vec3(t->inputs[0].factor, 1, 1, 1);
    expect_vec3(t->inputs[1].factor, 0.5, 0.5, 0.5);
    run_texture(&bench, false,
                TEXTURE("marble") "\"float variation\" .3 \"float scale\" 2 \"integer octaves\" 4");
    t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_MARBLE);
    expect_floats(t->parameters, (const double[]){4, 0.5, 2, 0.3}, 4);
    run_texture(&bench, true, TEXTURE("wrinkled") "\"float roughness\" .25");
    t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_WRINKLED);
    expect_floats(t->parameters, (const double[]){8, 0.25, 0, 0}, 4);
    run_texture(&bench, true, TEXTURE("windy"));
    assert_int_equal(first_texture(&bench)->kind, TEXTURE_WINDY);
    bench_close(&bench);
}

/* Where a texture's mapping takes a point of the world. */
static vec3_t mapped(const bench_t *bench, float x, float y, float z)
{
    return xform_point(&first_texture(bench)->texture_from_world, vec3(x, y, z));
}

static void mappings_of_textures_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_texture(
        &bench, true,
        TEXTURE("uv") "\"float uscale\" 2 \"float vscale\" 3 \"float udelta\" .5 \"float vdelta\" .25");
    expect_floats(first_texture(&bench)->matrix[0], (const double[]){2, 0, 0.5, 0, 3, 0.25}, 6);

    const char *planar = "Translate 1 0 0\n" TEXTURE(
        "checkerboard") "\"string mapping\" \"planar\" "
                        "\"vector v1\" [0 2 0] \"vector v2\" [0 0 1] \"float udelta\" 5";
    run_texture(&bench, true, planar); /* v3 looks at the world */
    assert_int_equal(first_texture(&bench)->mapping, MAPPING_PLANAR);
    expect_vec3(mapped(&bench, 7, 1, 3), 7, 3, 0);
    run_texture(&bench, false,
                "Translate 0 1 0\n" TEXTURE(
                    "checkerboard") "\"string mapping\" \"planar\" "
                                    "\"vector3 v1\" [0 2 0] \"vector3 v2\" [0 0 1] \"float udelta\" 5");
    expect_vec3(mapped(&bench, 7, 1, 3), 5, 3, 0); /* v4 at the texture's space */
    run_texture(&bench, true, "Translate 1 0 0\n" TEXTURE("checkerboard") "\"string mapping\" \"spherical\"");
    assert_int_equal(first_texture(&bench)->mapping, MAPPING_SPHERICAL);
    expect_vec3(mapped(&bench, 1, 2, 3), 0, 2, 3);
    run_texture(&bench, true, TEXTURE("checkerboard") "\"string mapping\" \"cylindrical\"");
    assert_int_equal(first_texture(&bench)->mapping, MAPPING_CYLINDRICAL);

    const char *space = "Scale 2 2 2\n" TEXTURE("checkerboard") "\"integer dimension\" 3";
    run_texture(&bench, true, space); /* v3 applies the transform itself, v4 its inverse */
    assert_int_equal(first_texture(&bench)->mapping, MAPPING_POINT);
    expect_vec3(mapped(&bench, 1, 2, 3), 2, 4, 6);
    run_texture(&bench, false, space);
    expect_vec3(mapped(&bench, 1, 2, 3), 0.5, 1, 1.5);
    bench_close(&bench);
}

/* A PFM of 2 x 1 pixels with the given values in R, G and B. */
static void write_pfm(bench_t *bench, const char *name, const float values[6])
{
    char head[] = "PF\n2 1\n-1\n";
    char data[sizeof head - 1 + 6 * sizeof(float)];
    memcpy(data, head, sizeof head - 1);
    memcpy(data + sizeof head - 1, values, 6 * sizeof(float));
    bench_write(bench, name, data, sizeof data);
}

/* A TGA without compression of 1 x 2 pixels: `channels`, of 1 to 4, bytes a pixel, rows from the bottom. */
static void write_tga(bench_t *bench, const char *name, uint8_t channels, const uint8_t *pixels)
{
    uint8_t data[18 + 8] = {[2] = channels <= 2 ? 3 : 2, [12] = 1, [14] = 2, [16] = (uint8_t)(8 * channels)};
    if (channels == 4) data[17] = 8;
    memcpy(data + 18, pixels, (size_t)2 * channels);
    bench_write(bench, name, data, 18 + (size_t)2 * channels);
}

static void images_are_stored_with_their_settings(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tga(&bench, "a.tga", 3, (const uint8_t[]){3, 2, 1, 6, 5, 4}); /* blue first */
    run_texture(&bench, true,
                TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"string wrap\" \"clamp\" "
                                    "\"float scale\" 2 \"float uscale\" 3 \"float vdelta\" .25 "
                                    "\"bool trilinear\" \"true\" \"float maxanisotropy\" 4");
    bench_expect_ok(&bench);
    const blob_texture_t *t = first_texture(&bench);
    assert_int_equal(t->kind, TEXTURE_IMAGE);
    assert_int_equal(t->channel, CHANNEL_RGB);
    assert_int_equal(t->wrap_s, WRAP_CLAMP);
    assert_int_equal(t->wrap_t, WRAP_CLAMP);
    assert_int_equal(t->flags, 0);
    expect_near((double)t->inputs[0].factor.y, 2, 0);
    expect_floats(t->matrix[0], (const double[]){3, 0, 0, 0, -1, 0.75}, 6); /* v = 0 is the bottom */
    const blob_image_t *image = &bench.blob.images[t->image - 1];
    assert_int_equal(image->format, TEXELS_RGBA8);
    assert_int_equal(image->width, 1);
    assert_int_equal(image->height, 2);
    expect_near((double)image->gamma, 0, 0);
    const uint8_t *bytes = (const uint8_t *)(bench.blob.texels + image->first_word);
    assert_memory_equal(bytes, ((const uint8_t[]){4, 5, 6, 255, 1, 2, 3, 255}), 8);
    bench_close(&bench);
}

/* A byte that no other pixel nearby has, from 0 to 250. */
static uint8_t code_at(uint32_t x, uint32_t y, uint32_t channel)
{
    return (uint8_t)((x * 7 + y * 11 + channel * 50) % 251);
}

/* An image of these bytes, as a TGA or as the floats of a PFM; rows from the bottom, blue first in the TGA.
 */
static void write_codes(bench_t *bench, const char *name, bool floats, uint32_t width, uint32_t height,
                        uint32_t channels)
{
    uint8_t tga[18] = {[2] = channels == 1 ? 3 : 2, [12] = (uint8_t)width, [14] = (uint8_t)height};
    tga[16] = (uint8_t)(8 * channels);
    char *pfm = mem_printf("%s\n%u %u\n-1\n", channels == 1 ? "Pf" : "PF", width, height);
    size_t head = floats ? strlen(pfm) : sizeof tga, unit = floats ? sizeof(float) : 1;
    uint8_t *data = mem_alloc(head + (size_t)width * height * channels * unit), *to = data + head;
    memcpy(data, floats ? (const uint8_t *)pfm : tga, head);
    for (uint32_t i = 0; i < width * height * channels; ++i, to += unit) {
        uint32_t pixel = i / channels, c = i % channels;
        uint8_t code = code_at(pixel % width, height - 1 - pixel / width, floats ? c : channels - 1 - c);
        float value = (float)code;
        if (floats)
            memcpy(to, &value, sizeof value);
        else
            *to = code;
    }
    bench_write(bench, name, data, (size_t)(to - data));
    free(data);
    free(pfm);
}

static void expect_codes(const bench_t *bench, uint32_t width, uint32_t height, uint32_t channels,
                         double unit)
{
    textures_t *textures = textures_new(&bench->blob);
    assert_int_equal(bench->blob.images[0].width, width);
    assert_int_equal(bench->blob.images[0].height, height);
    for (uint32_t y = 0; y < height; ++y)
        for (uint32_t x = 0; x < width; ++x) {
            rgb_t texel = textures_texel(textures, 0, x, y);
            expect_near((double)texel.x, unit * code_at(x, y, 0), 1e-6);
            expect_near((double)texel.z, unit * code_at(x, y, channels == 1 ? 0 : 2), 1e-6);
        }
    textures_destroy(&textures);
}

/* Images lie in bands of 32 rows: of fewer rows, of whole bands and of more, every pixel is where it was. */
static void images_of_all_sizes_keep_their_pixels(void **state)
{
    (void)state;
    static const uint32_t sizes[][2] = {{1, 1}, {3, 31}, {2, 32}, {5, 33}, {33, 2}, {34, 97}};
    bench_t bench = {0};
    for (size_t i = 0; i < 4 * ARRAY_LENGTH(sizes); ++i) {
        const uint32_t *size = sizes[i / 4], channels = i & 1 ? 3 : 1;
        bool floats = i & 2;
        write_codes(&bench, "a.tga", floats, size[0], size[1], channels); /* a PFM is known by its bytes */
        run_texture(&bench, true,
                    TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"bool gamma\" \"false\"");
        expect_codes(&bench, size[0], size[1], channels, floats ? 1 : 1 / 255.0);
    }
    bench_close(&bench);
}

static void encodings_of_images_are_applied(void **state)
{
    (void)state;
    static const struct {
        bool v3;
        const char *parameters;
        double gamma;
    } cases[] = {
        {true, "", 0},
        {true, "\"bool gamma\" \"false\"", 1},
        {true, "\"bool gamma\" \"true\"", 0},
        {false, "\"string encoding\" \"sRGB\"", 0},
        {false, "\"string encoding\" \"linear\"", 1},
        {false, "\"string encoding\" \"gamma 2.2\"", 2.2},
    };
    bench_t bench = {0};
    static const uint8_t png[] = {
        /* one grey pixel of 8 bits */
        0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52, 0x00,
        0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01, 0x08, 0x00, 0x00, 0x00, 0x00, 0x3a, 0x7e, 0x9b, 0x55, 0x00,
        0x00, 0x00, 0x0a, 0x49, 0x44, 0x41, 0x54, 0x78, 0x9c, 0x63, 0x68, 0x00, 0x00, 0x00, 0x82, 0x00, 0x81,
        0x77, 0xcd, 0x72, 0xb6, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60, 0x82,
    };
    bench_write(&bench, "a.png", png, sizeof png);
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = mem_printf(TEXTURE("imagemap") "\"string filename\" \"a.png\" %s", cases[i].parameters);
        run_texture(&bench, cases[i].v3, text);
        free(text);
        assert_int_equal(bench.blob.images[0].format, TEXELS_R8);
        expect_near((double)bench.blob.images[0].gamma, cases[i].gamma, 1e-6);
    }
    const float values[6] = {0.5f, 1, 0, 2, 1, 0};
    write_pfm(&bench, "a.pfm", values);
    run_texture(&bench, true, TEXTURE("imagemap") "\"string filename\" \"a.pfm\" \"bool gamma\" \"true\"");
    const float *floats = (const float *)bench.blob.texels;
    assert_int_equal(bench.blob.images[0].format, TEXELS_RGB32F);
    expect_near((double)bench.blob.images[0].gamma, 1, 0);
    expect_near((double)floats[0], pow((0.5 + 0.055) / 1.055, 2.4), 1e-6);
    run_texture(&bench, false,
                TEXTURE("imagemap") "\"string filename\" \"a.pfm\" \"string encoding\" \"sRGB\"");
    floats = (const float *)bench.blob.texels;
    assert_memory_equal(floats, values, sizeof values); /* v4 asks the encoding of PNG files alone */
    bench_close(&bench);
}

static void a_file_is_stored_once(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tga(&bench, "a.tga", 3, (const uint8_t[]){3, 2, 1, 6, 5, 4});
    bench_run_v3(
        &bench,
        "Texture \"a\" \"spectrum\" \"imagemap\" \"string filename\" \"a.tga\"\n"
        "Texture \"b\" \"float\" \"imagemap\" \"string filename\" \"a.tga\"\n"
        "Texture \"c\" \"float\" \"imagemap\" \"string filename\" \"a.tga\" \"bool gamma\" \"true\"\n"
        "Texture \"d\" \"float\" \"imagemap\" \"string filename\" \"a.tga\" \"bool gamma\" \"false\"\n"
        "Texture \"e\" \"float\" \"imagemap\" \"string filename\" \"a.tga\" \"bool gamma\" "
        "\"false\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_IMAGES], 2);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TEXELS], 2); /* of both */
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TEXTURES], 5);
    static const blob_ref_t images[] = {1, 1, 1, 2, 2};
    for (int i = 0; i < 5; ++i) assert_int_equal(bench.blob.textures[i].image, images[i]);
    assert_int_equal(bench.blob.textures[1].channel, CHANNEL_LUMINANCE);
    bench_close(&bench);
}

static void options_of_v4_images_are_applied(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tga(&bench, "a.tga", 3, (const uint8_t[]){3, 2, 1, 6, 5, 4});
    run_texture(&bench, false,
                TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"bool invert\" true "
                                    "\"string filter\" \"point\" \"string wrap\" \"black\"");
    const blob_texture_t *t = first_texture(&bench);
    assert_int_equal(t->flags, TEXTURE_NEAREST | TEXTURE_INVERT | TEXTURE_UNIT);
    assert_int_equal(t->wrap_s, WRAP_BLACK);
    bench_close(&bench);
}

/* pbrt-v4 reads the grey alone where it lies beside alpha. */
static void alpha_beside_grey_is_no_number(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tga(&bench, "a.tga", 2, (const uint8_t[]){7, 64, 9, 255});
    run_texture(&bench, false,
                "Texture \"f\" \"float\" \"imagemap\" \"string filename\" \"a.tga\"\n" TEXTURE(
                    "imagemap") "\"string filename\" \"a.tga\"");
    const blob_image_t *grey = &bench.blob.images[bench.blob.textures[0].image - 1];
    assert_int_equal(bench.blob.textures[0].channel, CHANNEL_R);
    assert_memory_equal(bench.blob.texels + grey->first_word, ((uint8_t[]){9, 7}), 2);
    bench_close(&bench);
}

static void images_on_other_mappings_are_upright(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_tga(&bench, "a.tga", 1, (const uint8_t[]){1, 2});
    run_texture(&bench, true,
                TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"string mapping\" \"planar\"");
    expect_vec3(mapped(&bench, 2, 0.25f, 9), 2, 0.75, 0);
    run_texture(&bench, true,
                TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"string mapping\" \"spherical\"");
    expect_vec3(mapped(&bench, 1, 2, 3), 1, -2, 3);
    run_texture(&bench, true,
                TEXTURE("imagemap") "\"string filename\" \"a.tga\" \"string mapping\" \"cylindrical\"");
    expect_vec3(mapped(&bench, 1, 2, 3), 1, 2, -3);
    bench_close(&bench);
}

/* A v3 material has the textures that were there when it was made, and so has one that is named. */
static void a_material_keeps_a_texture_that_is_replaced(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Texture \"t\" \"spectrum\" \"uv\"\n"
                 "MakeNamedMaterial \"one\" \"string type\" \"matte\" \"texture Kd\" \"t\"\n"
                 "Material \"mirror\" \"texture Kr\" \"t\"\n"
                 "Texture \"t\" \"spectrum\" \"dots\"\n" SPHERE "Shape \"sphere\" \"texture Kr\" \"t\"\n"
                 "NamedMaterial \"one\"\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(texture(&bench, value_of(&bench, 0, VALUE_REFLECTANCE).texture)->kind, TEXTURE_UV);
    assert_int_equal(texture(&bench, value_of(&bench, 1, VALUE_REFLECTANCE).texture)->kind, TEXTURE_DOTS);
    assert_int_equal(texture(&bench, value_of(&bench, 2, VALUE_REFLECTANCE).texture)->kind, TEXTURE_UV);
    bench_close(&bench);
}

static void bumps_and_normal_maps_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(
        &bench, "Texture \"b\" \"float\" \"windy\"\nTexture \"s\" \"float\" \"scale\" \"texture tex1\" \"b\" "
                "\"float tex2\" -.5\nMaterial \"matte\" \"texture bumpmap\" \"b\"\n" SPHERE
                "Material \"matte\" \"texture bumpmap\" \"s\"\n" SPHERE
                "Material \"matte\" \"float bumpmap\" 3\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(texture(&bench, material_of(&bench, 0)->bump)->kind, TEXTURE_WINDY);
    const blob_texture_t *scaled = texture(&bench, material_of(&bench, 1)->bump);
    assert_int_equal(scaled->kind, TEXTURE_SCALE);
    expect_near((double)scaled->inputs[0].factor.x, -0.5, 0);
    assert_int_equal(scaled->inputs[0].texture, 1);
    assert_int_equal(material_of(&bench, 2)->bump, 0);

    /* A mix of pbrt-v3 has the bumps of its first part, whatever its own or the second's. */
    bench_run_v3(&bench,
                 "Texture \"b\" \"float\" \"windy\"\nTexture \"c\" \"float\" \"dots\"\n"
                 "MakeNamedMaterial \"one\" \"string type\" \"matte\" \"texture bumpmap\" \"b\"\n"
                 "MakeNamedMaterial \"two\" \"string type\" \"mirror\" \"texture bumpmap\" \"c\"\n"
                 "Material \"mix\" \"string namedmaterial1\" \"one\" \"string namedmaterial2\" \"two\" "
                 "\"texture bumpmap\" \"c\"\n" SPHERE);
    bench_expect_ok(&bench);
    const blob_material_t *mix = material_of(&bench, 0);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_int_equal(texture(&bench, mix->bump)->kind, TEXTURE_WINDY);
    expect_text(bench.warnings, "bumpmap");

    write_tga(&bench, "n.tga", 3, (const uint8_t[]){3, 2, 1, 6, 5, 4});
    bench_run(&bench, "WorldBegin\nMaterial \"diffuse\" \"string normalmap\" \"n.tga\"\n" SPHERE);
    bench_expect_ok(&bench);
    const blob_texture_t *map = texture(&bench, material_of(&bench, 0)->normal_map);
    expect_floats(map->matrix[0], (const double[]){1, 0, 0, 0, -1, 1}, 6);
    expect_near((double)bench.blob.images[map->image - 1].gamma, 1, 0);
    expect_near((double)material_of(&bench, 0)->normal_scale, 1, 0);
    assert_int_equal(material_of(&bench, 0)->flags, MATERIAL_NORMALS_V4);
    bench_run(&bench,
              "WorldBegin\nTexture \"b\" \"float\" \"windy\"\nMaterial \"diffuse\" \"string normalmap\" "
              "\"n.tga\" \"texture displacement\" \"b\"\n" SPHERE); /* which alone counts in pbrt-v4 */
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:3:47: \"displacement\" is ignored, since there is \"normalmap\"");
    assert_int_equal(material_of(&bench, 0)->bump, 0);
    assert_int_not_equal(material_of(&bench, 0)->normal_map, 0);
    bench_close(&bench);
}

static void a_metal_may_have_a_textured_reflectance(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "WorldBegin\nTexture \"t\" \"spectrum\" \"dots\"\nMaterial \"conductor\" \"texture "
                      "reflectance\" \"t\"\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:3:22: a reflectance that varies tints the metal");
    assert_int_equal(value_of(&bench, 0, VALUE_REFLECTANCE).texture, 1);
    rgb_t k = colour_of(&bench, 0, VALUE_K);
    expect_near((double)(k.x * k.x / (4 + k.x * k.x)), 0.9999, 1e-5);
    bench_close(&bench);
}

static void spectra_become_colours(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "grey.spd", "400 .5\n700 .5\n", 14);
    bench_run_v3(&bench, "Material \"matte\" \"spectrum Kd\" [400 .5 700 .5]\n" SPHERE
                         "Material \"matte\" \"spectrum Kd\" \"grey.spd\"\n" SPHERE
                         "AreaLightSource \"diffuse\" \"blackbody L\" [6500 2]\n" SPHERE);
    bench_expect_silence(&bench);
    rgb_t numbers = colour_of(&bench, 0, VALUE_REFLECTANCE), file = colour_of(&bench, 1, VALUE_REFLECTANCE);
    assert_memory_equal(&numbers, &file, sizeof file);
    expect_near((double)numbers.x, 0.5 * 1.202, 1e-3); /* v3: equal energy is not white */
    assert_true(bench.blob.lights[0].radiance.factor.x > 0.5f);

    bench_run(&bench, "WorldBegin\nMaterial \"diffuse\" \"spectrum reflectance\" [400 .5 700 .5]\n" SPHERE
                      "Material \"diffuse\" \"spectrum reflectance\" \"grey.spd\"\n" SPHERE);
    bench_expect_ok(&bench);
    for (uint64_t i = 0; i < 2; ++i) {
        rgb_t c = colour_of(&bench, i, VALUE_REFLECTANCE); /* v4: grey under D65 */
        expect_near((double)c.x, 0.5, 1e-3);
        expect_near((double)c.z, 0.5, 1e-3);
    }
    bench_close(&bench);
}

/* Floats have steps of 0.0625 at a million, and of 0.5 from 2^22 on. */
static void a_scene_far_from_the_origin_is_told(void **state)
{
    (void)state;
#define LAMP "LightSource \"point\" "
#define FAR_SPHERE(x, radius) LAMP "Translate " x " 0 0 Shape \"sphere\" \"float radius\" " radius
#define FAR_OBJECT "ObjectBegin \"o\" " SPHERE "ObjectEnd Translate 0 -5e6 0 ObjectInstance \"o\""
    static const struct {
        const char *world, *warning;
    } cases[] = {
        {FAR_SPHERE("1000", "1"), NULL},
        {FAR_SPHERE("1e6", "1e3"), NULL}, /* large enough not to show it */
        {FAR_SPHERE("1e6", "1"),
         "lies 1e+06 from the origin, where coordinates are rounded to steps of 0.0625"},
        {FAR_SPHERE("-1e6", "1"), "move the scene to the origin"},
        {LAMP FAR_OBJECT, "steps of 0.5"},
        {LAMP SPHERE FAR_OBJECT, NULL}, /* all of the scene counts */
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_run_v3(&bench, cases[i].world);
        bench_expect_ok(&bench);
        if (cases[i].warning) expect_text(bench.warnings, cases[i].warning);
        assert_int_equal(bench.warning_count, cases[i].warning != NULL);
    }
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scenes_equal_their_v4_twins),
        cmocka_unit_test(the_seed_scenes_are_read),
        cmocka_unit_test(the_dialects_mean_the_same),
        cmocka_unit_test(what_is_not_said_has_the_default_of_its_dialect),
        cmocka_unit_test(a_camera_becomes_that_of_the_blob),
        cmocka_unit_test(samplers_and_integrators_are_read),
        cmocka_unit_test(transforms_are_applied_in_order),
        cmocka_unit_test(attributes_are_restored),
        cmocka_unit_test(attributes_of_v4_give_defaults),
        cmocka_unit_test(objects_become_instances),
        cmocka_unit_test(included_files_are_read_in_place),
        cmocka_unit_test(paths_begin_at_the_main_file),
        cmocka_unit_test(orientation_and_mirroring_turn_surfaces_over),
        cmocka_unit_test(vertex_normals_follow_the_surface),
        cmocka_unit_test(degenerate_triangles_are_left_out),
        cmocka_unit_test(v3_materials_become_ours),
        cmocka_unit_test(v3_materials_have_their_defaults),
        cmocka_unit_test(the_roughness_along_u_may_be_that_along_v),
        cmocka_unit_test(a_number_goes_before_a_spectrum_as_an_index),
        cmocka_unit_test(v4_materials_have_their_defaults),
        cmocka_unit_test(hair_has_its_defaults_in_both_dialects),
        cmocka_unit_test(hair_absorbs_by_the_first_of_its_pigments),
        cmocka_unit_test(curves_of_hair_are_fibres),
        cmocka_unit_test(mixes_refer_to_their_materials),
        cmocka_unit_test(shapes_that_only_bound_media_are_left_out),
        cmocka_unit_test(a_lenient_import_replaces_what_is_not_supported),
        cmocka_unit_test(v3_shapes_override_their_material),
        cmocka_unit_test(v4_materials_become_ours),
        cmocka_unit_test(names_have_scopes_in_v3),
        cmocka_unit_test(textures_have_two_name_spaces),
        cmocka_unit_test(an_unused_material_may_be_unsupported_but_not_silently),
        cmocka_unit_test(combining_textures_become_ours),
        cmocka_unit_test(patterns_become_ours),
        cmocka_unit_test(mappings_of_textures_become_ours),
        cmocka_unit_test(images_are_stored_with_their_settings),
        cmocka_unit_test(images_of_all_sizes_keep_their_pixels),
        cmocka_unit_test(encodings_of_images_are_applied),
        cmocka_unit_test(a_file_is_stored_once),
        cmocka_unit_test(options_of_v4_images_are_applied),
        cmocka_unit_test(alpha_beside_grey_is_no_number),
        cmocka_unit_test(images_on_other_mappings_are_upright),
        cmocka_unit_test(a_material_keeps_a_texture_that_is_replaced),
        cmocka_unit_test(bumps_and_normal_maps_are_read),
        cmocka_unit_test(a_metal_may_have_a_textured_reflectance),
        cmocka_unit_test(spectra_become_colours),
        cmocka_unit_test(a_scene_far_from_the_origin_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
