/* What the pbrt importer makes of shapes: their geometry, alpha, light, and motion. */
#include "tests/unit/client/import/test_import.h"

#define RADIANS(degrees) ((degrees)*3.14159265358979323846 / 180)

static const blob_shape_t *shape(const bench_t *bench, uint64_t index)
{
    assert_true(index < bench->blob.counts[BLOB_SECTION_SHAPES]);
    return &bench->blob.shapes[index];
}

static const blob_quadric_t *quadric(const bench_t *bench, uint64_t index)
{
    assert_int_equal(shape(bench, index)->kind, SHAPE_QUADRIC);
    return &bench->blob.quadrics[shape(bench, index)->geometry];
}

static const blob_light_t *light(const bench_t *bench, uint64_t index)
{
    assert_true(index < bench->blob.counts[BLOB_SECTION_LIGHTS]);
    return &bench->blob.lights[index];
}

static void run_v4(bench_t *bench, const char *world)
{
    char *text = mem_printf("Film \"rgb\"\nWorldBegin\n%s\n", world);
    bench_run(bench, text);
    free(text);
}

static void expect_error(bench_t *bench, const char *world, const char *message)
{
    bench_run_v3(bench, world);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, message);
    expect_text(bench->result.message, "s.pbrt:2:");
}

/* ---- quadrics ------------------------------------------------------------------------------------------ */

static void quadrics_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "Translate 1 2 3\nShape \"sphere\" \"float radius\" 2 \"float zmin\" 1 \"float zmax\" -9 "
                 "\"float phimax\" 90\n"
                 "ReverseOrientation Shape \"disk\" \"float height\" 4 \"float radius\" 3 "
                 "\"float innerradius\" 1\n"
                 "Scale -1 1 1 Shape \"cylinder\" \"float zmin\" 2 \"float zmax\" -1 \"float phimax\" 400");
    bench_expect_ok(&bench);
    const blob_quadric_t *sphere = quadric(&bench, 0), *disk = quadric(&bench, 1),
                         *cylinder = quadric(&bench, 2);
    assert_int_equal(sphere->kind, QUADRIC_SPHERE);
    expect_near((double)sphere->z_min, -2, 0);
    expect_near((double)sphere->z_max, 1, 0);
    expect_near((double)sphere->phi_max, RADIANS(90), 1e-6);
    expect_vec3(xform_point(&sphere->object_from_quadric, vec3(0, 0, 0)), 1, 2, 3);
    assert_int_equal(shape(&bench, 0)->flags, 0);
    assert_int_equal(disk->kind, QUADRIC_DISK);
    expect_near((double)disk->z_min, 4, 0);
    expect_near((double)disk->radius, 3, 0);
    expect_near((double)disk->inner_radius, 1, 0);
    assert_int_equal(shape(&bench, 1)->flags, SHAPE_FLIP);
    assert_int_equal(cylinder->kind, QUADRIC_CYLINDER);
    expect_near((double)cylinder->z_min, -1, 0);
    expect_near((double)cylinder->z_max, 2, 0);
    expect_near((double)cylinder->phi_max, RADIANS(360), 1e-6);
    assert_int_equal(shape(&bench, 2)->flags, 0); /* reversed, and once more by the mirroring */
    expect_near((double)shape(&bench, 2)->alpha.factor.x, 1, 0);
    expect_near((double)shape(&bench, 2)->shadow_alpha.factor.x, 1, 0);
    bench_run_v3(&bench, "Scale 1 -2 1 Shape \"sphere\" Shape \"cone\"\n"
                         "ReverseOrientation AreaLightSource \"diffuse\" Shape \"sphere\"");
    bench_expect_ok(&bench);
    assert_int_equal(shape(&bench, 0)->flags, SHAPE_FLIP);
    const blob_mesh_t *cone = &bench.blob.meshes[shape(&bench, 1)->geometry];
    vec3_t p = bench.blob.positions[cone->first_position], n = bench.blob.normals[cone->first_normal];
    assert_true(p.x * n.x + p.y * n.y < 0);
    assert_int_equal(shape(&bench, 2)->flags, SHAPE_FLIP); /* a light is not turned by a mirroring */
    bench_close(&bench);
}

/* pbrt-v3 alone, and what has vertex normals there. */
static void meshes_have_the_bumps_of_their_dialect(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *smooth =
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0] \"normal N\" [0 0 1 0 0 1 0 0 1]\n"
        "Shape \"trianglemesh\" \"point3 P\" [0 0 0 1 0 0 0 1 0]\nShape \"cylinder\"";
    bench_run_v3(&bench, smooth);
    bench_expect_ok(&bench);
    assert_int_equal(shape(&bench, 0)->flags, SHAPE_BUMPS_V3 | SHAPE_NORMALS_V3);
    assert_int_equal(shape(&bench, 1)->flags, 0);
    assert_int_equal(shape(&bench, 2)->flags, 0);
    char *v4 = mem_printf("WorldBegin\n%s", smooth);
    bench_run(&bench, v4);
    free(v4);
    bench_expect_ok(&bench);
    assert_int_equal(shape(&bench, 0)->flags, 0);
    bench_close(&bench);
}

static void impossible_quadrics_are_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(&bench, "Shape \"sphere\" \"float radius\" 0", "radius is 0");
    expect_error(&bench, "Shape \"sphere\" \"float zmin\" 2 \"float zmax\" 3", "nothing of the sphere");
    expect_error(&bench, "Shape \"sphere\" \"float phimax\" -1", "phimax is -1");
    expect_error(&bench, "Shape \"disk\" \"float innerradius\" 1", "innerradius is 1");
    expect_error(&bench, "Shape \"cylinder\" \"float zmin\" 1", "no height");
    expect_error(&bench, "Shape \"disk\" \"float height\" 1e300", "not finite");
    bench_close(&bench);
}

/* ---- tessellated shapes -------------------------------------------------------------------------------- */

static void tessellated_shapes_become_meshes(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "Shape \"cone\" \"float height\" 2",
        "Shape \"paraboloid\"",
        "Shape \"hyperboloid\" \"point p1\" [1 0 0] \"point p2\" [.5 .5 1]",
        "Shape \"heightfield\" \"integer nu\" 2 \"integer nv\" 2 \"float Pz\" [0 1 0 1]",
        "Shape \"loopsubdiv\" \"integer nlevels\" 1 \"point P\" [1 1 1  -1 -1 1  -1 1 -1  1 -1 -1] "
        "\"integer indices\" [0 1 2 0 3 1 0 2 3 1 3 2]",
        "Shape \"nurbs\" \"integer nu\" 2 \"integer nv\" 2 \"integer uorder\" 2 \"integer vorder\" 2 "
        "\"float uknots\" [0 0 1 1] \"float vknots\" [0 0 1 1] \"float u0\" .25 "
        "\"point P\" [0 0 0  1 0 0  0 1 0  1 1 0]"};
    for (size_t i = 0; i < ARRAY_LENGTH(texts); ++i) {
        bench_t bench = {0};
        char *world = mem_printf("LightSource \"point\"\nTranslate 0 0 10\n%s", texts[i]);
        bench_run_v3(&bench, world);
        bench_expect_ok(&bench);
        assert_int_equal(shape(&bench, 0)->kind, SHAPE_MESH);
        assert_true(bench.blob.counts[BLOB_SECTION_TRIANGLES] >= 2);
        for (uint64_t k = 0; k < bench.blob.counts[BLOB_SECTION_POSITIONS]; ++k)
            assert_true(bench.blob.positions[k].z >= 9 && bench.blob.positions[k].z <= 12);
        free(world);
        bench_close(&bench);
    }
}

static void a_bilinear_mesh_becomes_triangles(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_v4(&bench, "LightSource \"point\" Shape \"bilinearmesh\" \"point3 P\" [0 0 0  1 0 0  0 1 0  1 1 0]");
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], 2);
    bench_close(&bench);
}

/* ---- curves -------------------------------------------------------------------------------------------- */

static const blob_curve_point_t *points_of(const bench_t *bench, uint64_t index)
{
    assert_int_equal(shape(bench, index)->kind, SHAPE_CURVES);
    return bench->blob.curve_points + bench->blob.curves[shape(bench, index)->geometry].first_point;
}

static void expect_point(const blob_curve_point_t *p, double x, double y, double z, double radius)
{
    expect_vec3(vec3(p->x, p->y, p->z), x, y, z);
    expect_near((double)p->radius, radius, 1e-6);
}

static void a_bezier_curve_becomes_segments(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "LightSource \"point\" Scale 2 2 2\n"
                         "Shape \"curve\" \"string type\" \"cylinder\" \"float width0\" 2 \"float width1\" 1 "
                         "\"integer splitdepth\" 3 "
                         "\"point P\" [0 0 0  1 0 0  2 0 0  3 0 0  4 1 0  5 1 0  6 0 0]");
    bench_expect_silence(&bench);
    const blob_curve_point_t *p = points_of(&bench, 0);
    assert_int_equal(bench.blob.curves[0].segment_count, 2);
    assert_int_equal(bench.blob.curves[0].kind, CURVES_ROUND);
    expect_point(&p[0], 0, 0, 0, 2);
    expect_point(&p[3], 6, 0, 0, 1.5);
    expect_point(&p[4], 6, 0, 0, 1.5);
    expect_point(&p[5], 8, 2, 0, 1.5 - 1.0 / 6);
    expect_point(&p[7], 12, 0, 0, 1);
    bench_close(&bench);
}

/* A point of the curve from its Bezier control points, and from the basis it was given in. */
static double cubic_at(const double c[4], double t)
{
    double s = 1 - t;
    return s * s * s * c[0] + 3 * s * s * t * c[1] + 3 * s * t * t * c[2] + t * t * t * c[3];
}

static double spline_at(const double c[4], int degree, double t)
{
    double t2 = t * t, t3 = t2 * t;
    if (degree == 2) return ((1 - 2 * t + t2) * c[0] + (1 + 2 * t - 2 * t2) * c[1] + t2 * c[2]) / 2;
    return ((1 - 3 * t + 3 * t2 - t3) * c[0] + (4 - 6 * t2 + 3 * t3) * c[1] +
            (1 + 3 * t + 3 * t2 - 3 * t3) * c[2] + t3 * c[3]) /
           6;
}

static void splines_are_the_same_curve(void **state)
{
    (void)state;
    static const double y[5] = {0, 3, -1, 4, 2};
    for (int degree = 2; degree <= 3; ++degree) {
        bench_t bench = {0};
        char *world =
            mem_printf("LightSource \"point\" Shape \"curve\" \"string type\" \"cylinder\" \"string basis\" "
                       "\"bspline\" \"integer degree\" %d \"point P\" [0 0 0  1 3 0  2 -1 0  3 4 0  4 2 0]",
                       degree);
        bench_run_v3(&bench, world);
        bench_expect_silence(&bench);
        const blob_curve_point_t *p = points_of(&bench, 0);
        assert_int_equal(bench.blob.curves[0].segment_count, 5 - degree);
        for (int segment = 0; segment < 5 - degree; ++segment)
            for (double t = 0; t <= 1; t += 0.25) {
                const blob_curve_point_t *s = p + 4 * segment;
                const double bezier[4] = {(double)s[0].y, (double)s[1].y, (double)s[2].y, (double)s[3].y};
                expect_near(cubic_at(bezier, t), spline_at(y + segment, degree, t), 1e-5);
            }
        free(world);
        bench_close(&bench);
    }
}

static void a_quadratic_bezier_is_raised(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench,
                 "LightSource \"point\" Shape \"curve\" \"string type\" \"cylinder\" \"integer degree\" 2 "
                 "\"point P\" [0 0 0  3 3 0  6 0 0]");
    bench_expect_silence(&bench);
    expect_point(&points_of(&bench, 0)[1], 2, 2, 0, 0.5);
    expect_point(&points_of(&bench, 0)[2], 4, 2, 0, 0.5);
    bench_close(&bench);
}

static void a_ribbon_turns_with_its_normals(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "LightSource \"point\" Scale 1 1 2\n"
                         "Shape \"curve\" \"string type\" \"ribbon\" \"normal N\" [0 0 1  0 1 0] "
                         "\"point P\" [0 0 0  1 0 0  2 0 0  3 0 0]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "stretches this curve");
    const blob_curves_t *curves = &bench.blob.curves[0];
    assert_int_equal(curves->kind, CURVES_RIBBON);
    const vec3_t *n = bench.blob.normals + curves->first_normal;
    expect_vec3(n[0], 0, 0, 1);
    expect_vec3(n[1], 0, 0.5, sqrt(0.75)); /* a third of the way */
    expect_vec3(n[3], 0, 1, 0);
    expect_near((double)points_of(&bench, 0)[0].radius, cbrt(2) / 2, 1e-6);
    bench_close(&bench);
}

static void impossible_curves_are_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(&bench, "Shape \"curve\" \"point P\" [0 0 0  1 0 0  2 0 0]", "3 control points");
    expect_error(&bench, "Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0 4 0 0]", "5 control points");
    expect_error(&bench, "Shape \"curve\"", "0 control points");
    expect_error(&bench, "Shape \"curve\" \"integer degree\" 4 \"point P\" [0 0 0]", "from 2 to 3");
    expect_error(&bench, "Shape \"curve\" \"string basis\" \"hermite\"", "hermite");
    expect_error(&bench, "Shape \"curve\" \"string type\" \"ribbon\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0]",
                 "needs 2 normals");
    expect_error(&bench, "Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 1e30 0 0]", "below 1e18");
    expect_error(&bench,
                 "Shape \"curve\" \"float width\" 1e-37 \"point P\" [0 0 0 1e-37 0 0 2e-37 0 0 3e-37 0 0]",
                 "smaller than 1e-30");
    bench_run_v3(&bench, "LightSource \"point\" Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0]\n"
                         "Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0]");
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "flat curves");
    expect_error(&bench,
                 "AreaLightSource \"diffuse\" Shape \"curve\" \"string type\" \"cylinder\" \"point P\" "
                 "[0 0 0 1 0 0 2 0 0 3 0 0]",
                 "curves that emit");
    bench_close(&bench);
}

/* ---- alpha --------------------------------------------------------------------------------------------- */

#define TRIANGLE "Shape \"trianglemesh\" \"point3 P\" [0 0 0  1 0 0  0 1 0] "

static void alpha_comes_from_shape_and_material(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "LightSource \"point\"\n"
                         "Texture \"holes\" \"float\" \"checkerboard\"\n" TRIANGLE
                         "\"texture alpha\" \"holes\"\n" TRIANGLE "\"float shadowalpha\" .5\n" TRIANGLE);
    bench_expect_ok(&bench);
    assert_int_equal(shape(&bench, 0)->flags, SHAPE_CUTOUT);
    assert_int_equal(shape(&bench, 0)->alpha.texture, 1);
    assert_int_equal(shape(&bench, 0)->shadow_alpha.texture, 0);
    assert_int_equal(shape(&bench, 1)->flags, SHAPE_CUTOUT);
    expect_near((double)shape(&bench, 1)->shadow_alpha.factor.x, 0.5, 0);
    assert_int_equal(shape(&bench, 2)->flags, 0);
    bench_run(&bench, "Integrator \"bdpt\"\nWorldBegin\nLightSource \"point\"\n" TRIANGLE
                      "\"float shadowalpha\" .5\nWorldEnd\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "\"shadowalpha\" is ignored");
    expect_near((double)shape(&bench, 0)->shadow_alpha.factor.x, 1, 0);
    run_v4(&bench, "LightSource \"point\" Shape \"sphere\" \"float alpha\" .25");
    bench_expect_silence(&bench);
    assert_int_equal(shape(&bench, 0)->flags, 0);
    expect_near((double)shape(&bench, 0)->alpha.factor.x, 0.25, 0);
    bench_close(&bench);
}

/* ---- area lights --------------------------------------------------------------------------------------- */

static void the_power_of_a_shape_scales_its_light(void **state)
{
    (void)state;
    static const struct {
        const char *shape;
        double area; /* of all that shares the power */
    } cases[] = {
        {"Shape \"sphere\" \"float radius\" 2", 16},
        {"Shape \"sphere\" \"float zmin\" 0 \"float phimax\" 180", 1},
        {"Shape \"disk\" \"float radius\" 2 \"float innerradius\" 1", 3},
        {"Shape \"cylinder\" \"float radius\" 3", 12},
        {"Scale 3 3 3 Shape \"disk\"", 9},
        {"Scale 2 3 1 Shape \"disk\"", 6},
        {"Shape \"bilinearmesh\" \"point3 P\" [0 0 0  2 0 0  0 3 0  2 3 0]", 6 / RADIANS(180)},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        char *world = mem_printf("AreaLightSource \"diffuse\" \"float power\" 100 \"rgb L\" [2 1 .5]\n%s",
                                 cases[i].shape);
        run_v4(&bench, world);
        bench_expect_silence(&bench);
        double expected = 100 / (RADIANS(180) * RADIANS(180) * cases[i].area);
        expect_near((double)light(&bench, 0)->radiance.factor.y / expected, 1, 1e-4);
        expect_near((double)light(&bench, 0)->radiance.factor.x / expected, 2, 1e-4);
        free(world);
        bench_close(&bench);
    }
}

/* The ellipsoid (2, 3, 4) by Legendre's integrals, from a table: 111.5457; the midpoint rule comes near. */
static void the_area_of_an_ellipsoid_is_legendres(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_v4(&bench, "Scale 2 3 4 AreaLightSource \"diffuse\" \"float power\" 1 \"bool twosided\" true\n"
                   "Shape \"sphere\"");
    bench_expect_silence(&bench);
    double area = 1 / (2 * RADIANS(180) * (double)light(&bench, 0)->radiance.factor.x);
    expect_near(area, 111.5457, 0.02);
    assert_int_equal(light(&bench, 0)->flags, LIGHT_TWO_SIDED);
    bench_close(&bench);
}

static void every_triangle_and_every_quad_has_the_power(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_v4(&bench, "AreaLightSource \"diffuse\" \"float power\" 10 Shape \"trianglemesh\" "
                   "\"point3 P\" [0 0 0  1 0 0  1 1 0  0 1 0] \"integer indices\" [0 1 2 0 2 3]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "each of the 2 parts");
    expect_near((double)light(&bench, 0)->radiance.factor.x, 20 / RADIANS(180), 1e-4);
    static const char quads[] =
        "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\n"
        "property float z\nelement face 3\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0\n1 0 0\n2 0 0\n0 1 0\n1 1 0\n2 1 0\n0 3 0\n"
        "4 0 1 4 3\n4 1 2 5 4\n3 3 4 6\n"; /* of area 3 in all */
    bench_write(&bench, "q.ply", quads, strlen(quads));
    run_v4(&bench,
           "AreaLightSource \"diffuse\" \"float power\" 10 Shape \"plymesh\" \"string filename\" \"q.ply\"");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "each of the 3 parts");
    expect_near((double)light(&bench, 0)->radiance.factor.x, 10 / RADIANS(180), 1e-4);
    bench_close(&bench);
}

static void area_lights_of_objects_do_not_emit(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_v4(&bench, "LightSource \"point\" AreaLightSource \"diffuse\"\n"
                   "ObjectBegin \"o\" Shape \"sphere\" ObjectEnd ObjectInstance \"o\"");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 1);
    expect_text(bench.warnings, "of an object does not emit");
    run_v4(&bench, "LightSource \"point\" Material \"interface\" Shape \"sphere\"");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 0);
    run_v4(&bench, "AreaLightSource \"diffuse\" Shape \"sphere\" \"float alpha\" 0");
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.lights[0].flags, LIGHT_UNSEEN);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0, 0);
    bench_run_v3(&bench, "AreaLightSource \"diffuse\" Shape \"trianglemesh\" "
                         "\"point P\" [0 0 0 1 0 0 0 1 0] \"float alpha\" 0");
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "a light with an alpha of 0 shines unseen; pbrt-v3 loses a part of its light");
    assert_int_equal(bench.blob.lights[0].flags, LIGHT_UNSEEN);
    bench_close(&bench);
}

static void an_image_colours_a_light(void **state)
{
    (void)state;
    static const char pfm[] = "PF\n1 2\n-1\n";
    /* rows from the bottom: (0 0 0), then (1 1 1) */
    const float values[6] = {0, 0, 0, 1, 1, 1};
    char file[sizeof pfm - 1 + sizeof values];
    memcpy(file, pfm, sizeof pfm - 1);
    memcpy(file + sizeof pfm - 1, values, sizeof values);
    bench_t bench = {0};
    bench_write(&bench, "i.pfm", file, sizeof file);
    run_v4(&bench,
           "AreaLightSource \"diffuse\" \"string filename\" \"i.pfm\" \"float power\" 1 Shape \"disk\"");
    bench_expect_silence(&bench);
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->radiance.texture, 1);
    const blob_texture_t *t = &bench.blob.textures[0];
    assert_int_equal(t->kind, TEXTURE_IMAGE);
    assert_int_equal(t->flags & TEXTURE_NEAREST, 0);
    /* v = 1 is the top row, t = 0 */
    expect_near((double)(t->matrix[1][1] * 1 + t->matrix[1][2]), 0, 0);
    expect_near((double)l->radiance.factor.x, 2 / (RADIANS(180) * RADIANS(180)), 1e-6);
    run_v4(&bench, "AreaLightSource \"diffuse\" \"string filename\" \"i.pfm\" \"rgb L\" [1 1 1]");
    expect_text(bench.result.message, "not both");
    bench_close(&bench);
}

/* ---- motion -------------------------------------------------------------------------------------------- */

static void shapes_and_instances_may_move(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "LightSource \"point\"\n"
                         "ObjectBegin \"o\" Shape \"sphere\" ObjectEnd\n"
                         "AttributeBegin ActiveTransform EndTime Translate 0 0 5 ActiveTransform All\n"
                         "Translate 1 0 0 Shape \"disk\" ObjectInstance \"o\" AttributeEnd\n"
                         "Shape \"cylinder\"");
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_OBJECTS], 3);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 2);
    assert_int_equal(bench.blob.objects[0].shape_count, 1); /* the cylinder stands still */
    for (uint64_t i = 0; i < 2; ++i) {
        const blob_instance_t *instance = &bench.blob.instances[i];
        expect_vec3(xform_point(&instance->world_from_object, vec3(0, 0, 0)), 1, 0, 0);
        expect_vec3(xform_point(&instance->world_from_object_end, vec3(0, 0, 0)), 1, 0, 5);
    }
    /* the disk's own geometry is in its own space */
    const blob_object_t *disk = &bench.blob.objects[bench.blob.instances[0].object];
    expect_vec3(xform_point(&quadric(&bench, disk->first_shape)->object_from_quadric, vec3(0, 0, 0)), 0, 0,
                0);
    bench_close(&bench);
}

static void motion_is_cut_to_the_shutter(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "TransformTimes 0 4\nCamera \"perspective\" \"float shutteropen\" 1 \"float shutterclose\" 2\n"
              "WorldBegin LightSource \"point\"\nActiveTransform EndTime Translate 8 0 0 Rotate 120 0 0 1 "
              "Scale 3 1 1\nShape \"sphere\"\nWorldEnd\n");
    bench_expect_silence(&bench);
    const blob_instance_t *instance = &bench.blob.instances[0];
    expect_vec3(xform_point(&instance->world_from_object, vec3(0, 0, 0)), 2, 0, 0);
    expect_vec3(xform_point(&instance->world_from_object_end, vec3(0, 0, 0)), 4, 0, 0);
    expect_vec3(xform_vector(&instance->world_from_object_end, vec3(0, 1, 0)), -sin(RADIANS(60)), 0.5, 0);
    expect_vec3(xform_vector(&instance->world_from_object_end, vec3(1, 0, 0)), 1, 2 * sin(RADIANS(60)), 0);
    bench_run(&bench, "TransformTimes .5 .75\nWorldBegin LightSource \"point\"\nActiveTransform EndTime "
                      "Translate 8 0 0\nShape \"sphere\"\nWorldEnd\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "while the shutter is open");
    bench_close(&bench);
}

static void what_does_not_move_has_one_transform(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run_v3(&bench, "ActiveTransform EndTime Translate 0 0 5 ActiveTransform All\n"
                         "LightSource \"point\"\n"
                         "ObjectBegin \"o\" Shape \"sphere\" ObjectEnd\n"
                         "AreaLightSource \"diffuse\" Shape \"disk\"");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "lights do not move");
    expect_text(bench.warnings, "does not move in its object");
    expect_text(bench.warnings, "a shape that emits does not move");
    expect_vec3(xform_point(&quadric(&bench, 0)->object_from_quadric, vec3(0, 0, 0)), 0, 0, 0);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 0);
    bench_close(&bench);
}

/* A mirroring that turns keeps mirroring on the way. */
static void a_mirroring_that_turns_keeps_mirroring(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "TransformTimes 0 2\nWorldBegin LightSource \"point\" Scale -1 1 1\nActiveTransform EndTime "
              "Rotate 90 0 0 1\nShape \"sphere\"\nWorldEnd\n");
    bench_expect_silence(&bench);
    const blob_instance_t *instance = &bench.blob.instances[0];
    expect_near((double)xform_determinant(&instance->world_from_object_end), -1, 1e-5);
    expect_vec3(xform_vector(&instance->world_from_object_end, vec3(0, 0, 1)), 0, 0, 1);
    expect_vec3(xform_vector(&instance->world_from_object_end, vec3(1, 0, 0)), -sqrt(0.5), sqrt(0.5), 0);
    bench_close(&bench);
}

/* ---- files --------------------------------------------------------------------------------------------- */

static void an_import_is_a_scope(void **state)
{
    (void)state;
    static const char part[] = "Translate 1 0 0 Shape \"sphere\" AreaLightSource \"diffuse\"\n";
    bench_t bench = {0};
    bench_write(&bench, "part.pbrt", part, strlen(part));
    run_v4(&bench, "LightSource \"point\" Import \"part.pbrt\" Shape \"sphere\"");
    bench_expect_silence(&bench);
    expect_vec3(xform_point(&quadric(&bench, 0)->object_from_quadric, vec3(0, 0, 0)), 1, 0, 0);
    expect_vec3(xform_point(&quadric(&bench, 1)->object_from_quadric, vec3(0, 0, 0)), 0, 0, 0);
    assert_int_equal(shape(&bench, 1)->light, BLOB_NONE);
    bench_write(&bench, "part.pbrt", "AttributeBegin\n", 15);
    run_v4(&bench, "Import \"part.pbrt\"");
    expect_text(bench.result.message, "leaves this block open");
    bench_write(&bench, "part.pbrt", "AttributeEnd AttributeBegin\n", 28);
    run_v4(&bench, "Import \"part.pbrt\"");
    expect_text(bench.result.message, "the Import of line");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(quadrics_become_ours),
        cmocka_unit_test(meshes_have_the_bumps_of_their_dialect),
        cmocka_unit_test(impossible_quadrics_are_refused),
        cmocka_unit_test(tessellated_shapes_become_meshes),
        cmocka_unit_test(a_bilinear_mesh_becomes_triangles),
        cmocka_unit_test(a_bezier_curve_becomes_segments),
        cmocka_unit_test(splines_are_the_same_curve),
        cmocka_unit_test(a_quadratic_bezier_is_raised),
        cmocka_unit_test(a_ribbon_turns_with_its_normals),
        cmocka_unit_test(impossible_curves_are_refused),
        cmocka_unit_test(alpha_comes_from_shape_and_material),
        cmocka_unit_test(the_power_of_a_shape_scales_its_light),
        cmocka_unit_test(the_area_of_an_ellipsoid_is_legendres),
        cmocka_unit_test(every_triangle_and_every_quad_has_the_power),
        cmocka_unit_test(area_lights_of_objects_do_not_emit),
        cmocka_unit_test(an_image_colours_a_light),
        cmocka_unit_test(shapes_and_instances_may_move),
        cmocka_unit_test(motion_is_cut_to_the_shutter),
        cmocka_unit_test(what_does_not_move_has_one_transform),
        cmocka_unit_test(a_mirroring_that_turns_keeps_mirroring),
        cmocka_unit_test(an_import_is_a_scope),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
