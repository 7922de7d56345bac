/* Quadrics against what they are: points, coordinates, derivatives, crossings, areas and samples. */
#include "worker/render/scene/quadric.h"

#include "client/import/import.h"
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "tests/scratch.h"
#include "worker/render/scene/scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const blob_quadric_t shapes[] = {
    {.kind = QUADRIC_SPHERE, .radius = 1.5f, .z_min = -1.5f, .z_max = 1.5f, .phi_max = TWO_PI_F},
    {.kind = QUADRIC_SPHERE, .radius = 1.5f, .z_min = -0.7f, .z_max = 1.2f, .phi_max = 4},
    {.kind = QUADRIC_DISK, .radius = 2, .z_min = 0.4f, .phi_max = TWO_PI_F},
    {.kind = QUADRIC_DISK, .radius = 2, .inner_radius = 0.5f, .z_min = -0.4f, .phi_max = 2},
    {.kind = QUADRIC_CYLINDER, .radius = 0.7f, .z_min = -1, .z_max = 2, .phi_max = TWO_PI_F},
    {.kind = QUADRIC_CYLINDER, .radius = 0.7f, .z_min = -1, .z_max = 0.5f, .phi_max = 5},
};

/* Nothing; a turn with an even scale; a stretch, a shear and a mirroring. */
static const xform_t places[] = {
    {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    {{{1.2f, 0, -1.6f, 3}, {0, 2, 0, -2}, {1.6f, 0, 1.2f, 1}}},
    {{{-1, 0.3f, 0, -4}, {0, 2, 0.1f, 1}, {0.2f, 0.2f, 0.5f, 7}}},
};

/* Calls a test for every shape in every place. */
static void for_all(void (*check)(const quadric_t *))
{
    for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
        for (size_t k = 0; k < sizeof places / sizeof *places; k++) {
            blob_quadric_t record = shapes[i];
            record.object_from_quadric = places[k];
            quadric_t quadric;
            quadric_init(&quadric, &record);
            check(&quadric);
        }
}

static vec2_t random_2d(uint32_t i, uint32_t dimension)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 21, 0, i);
    sampler.dimension = dimension;
    return sampler_2d(&sampler);
}

/* pbrt's parametrisations, in double precision. */
static vec3_t point_at(const quadric_t *quadric, double u, double v)
{
    const blob_quadric_t *q = quadric->record;
    double phi = u * (double)q->phi_max, r = q->radius, z = q->z_min, across = r;
    if (q->kind == QUADRIC_SPHERE) {
        double low = acos(fmax((double)q->z_min / r, -1)), high = acos(fmin((double)q->z_max / r, 1));
        double theta = low + v * (high - low);
        z = r * cos(theta);
        across = r * sin(theta);
    } else if (q->kind == QUADRIC_CYLINDER) {
        z += v * ((double)q->z_max - (double)q->z_min);
    } else {
        across = r - v * (r - (double)q->inner_radius);
    }
    double x = across * cos(phi), y = across * sin(phi);
    const float(*m)[4] = q->object_from_quadric.m;
    float out[3];
    for (int i = 0; i < 3; i++)
        out[i] = (float)((double)m[i][0] * x + (double)m[i][1] * y + (double)m[i][2] * z + (double)m[i][3]);
    return vec3(out[0], out[1], out[2]);
}

static void assert_near(vec3_t a, vec3_t b, float tolerance)
{
    if (!(v_length(v_sub(a, b)) <= tolerance))
        fail_msg("(%g %g %g) is not (%g %g %g)", (double)a.x, (double)a.y, (double)a.z, (double)b.x,
                 (double)b.y, (double)b.z);
}

/* The part of a change of the normal that turns it. */
static vec3_t turning(vec3_t change, vec3_t n)
{
    return v_mad(change, -v_dot(change, n), n);
}

/* A point with all its details. */
typedef struct {
    quadric_point_t point;
    quadric_details_t details;
} whole_point_t;

static whole_point_t whole_at(const quadric_t *quadric, vec3_t p)
{
    whole_point_t at;
    quadric_at(quadric, p, &at.point);
    quadric_details(quadric, p, &at.details);
    return at;
}

static void check_derivatives(const quadric_t *quadric)
{
    const float step = 1e-3f;
    for (uint32_t i = 0; i < 200; i++) {
        vec2_t uv = random_2d(i, 0);
        uv.x = 0.02f + 0.96f * uv.x, uv.y = 0.02f + 0.96f * uv.y;
        quadric_point_t u0, u1, v0, v1;
        vec3_t p = point_at(quadric, uv.x, uv.y);
        whole_point_t whole = whole_at(quadric, p);
        quadric_point_t at = whole.point;
        quadric_details_t d = whole.details;
        assert_near(at.p, p, 1e-5f);
        assert_float_equal(d.uv.x, uv.x, 2e-5f);
        assert_float_equal(d.uv.y, uv.y, 2e-5f);
        assert_float_equal(v_length(at.n), 1, 1e-5f);
        quadric_at(quadric, point_at(quadric, (double)(uv.x - step), uv.y), &u0);
        quadric_at(quadric, point_at(quadric, (double)(uv.x + step), uv.y), &u1);
        quadric_at(quadric, point_at(quadric, uv.x, (double)(uv.y - step)), &v0);
        quadric_at(quadric, point_at(quadric, uv.x, (double)(uv.y + step)), &v1);
        float inverse = 0.5f / step, longest = 1 + v_length(d.dpdu) + v_length(d.dpdv);
        assert_near(v_scale(v_sub(u1.p, u0.p), inverse), d.dpdu, 4e-3f * longest);
        assert_near(v_scale(v_sub(v1.p, v0.p), inverse), d.dpdv, 4e-3f * longest);
        float turn = 1 + v_length(d.dndu) + v_length(d.dndv);
        assert_near(v_scale(v_sub(u1.n, u0.n), inverse), turning(d.dndu, at.n), 4e-3f * turn);
        assert_near(v_scale(v_sub(v1.n, v0.n), inverse), turning(d.dndv, at.n), 4e-3f * turn);
        assert_true(fabsf(v_dot(at.n, d.dpdu)) < 1e-4f * longest &&
                    fabsf(v_dot(at.n, d.dpdv)) < 1e-4f * longest);
        /* Away from the axis or centre; of a disk along +z. */
        const xform_t *t = &quadric->record->object_from_quadric;
        vec3_t axis = vec3(t->m[0][2], t->m[1][2], t->m[2][2]),
               from = vec3(t->m[0][3], t->m[1][3], t->m[2][3]);
        vec3_t local = xform_point(&quadric->quadric_from_object, p);
        vec3_t out = quadric->record->kind == QUADRIC_DISK ? axis : v_sub(p, from);
        if (quadric->record->kind == QUADRIC_CYLINDER) out = v_mad(out, -local.z, axis);
        assert_true(v_dot(at.n, out) > 0);
    }
}

static void points_have_their_derivatives(void **state)
{
    (void)state;
    for_all(check_derivatives);
}

/* A line through two points of a quadric crosses it there, and nowhere else. */
static void check_crossings(const quadric_t *quadric)
{
    bool disk = quadric->record->kind == QUADRIC_DISK;
    for (uint32_t i = 0; i < 500; i++) {
        vec2_t a = random_2d(i, 0), b = random_2d(i, 1), elsewhere = random_2d(i, 2);
        vec3_t p = point_at(quadric, a.x, a.y), q = point_at(quadric, b.x, b.y);
        vec3_t outside = v_add(p, vec3(3 * elsewhere.x - 1, 3 * elsewhere.y - 1, 2));
        vec3_t d = v_normalize(disk ? v_sub(p, outside) : v_sub(q, p));
        vec3_t origin = v_mad(p, -5, d);
        float distances[2] = {0, 0};
        int count = quadric_crossings(quadric, origin, d, distances);
        float edge = float_min(float_min(a.x, 1 - a.x), float_min(a.y, 1 - a.y));
        edge = float_min(edge, float_min(float_min(b.x, 1 - b.x), float_min(b.y, 1 - b.y)));
        quadric_point_t at;
        quadric_at(quadric, p, &at);
        float steep = fabsf(v_dot(at.n, d));
        if (edge < 1e-3f || steep < 0.1f) continue; /* rounding decides */
        assert_int_equal(count, disk ? 1 : 2);
        if (count == 2) assert_true(distances[0] <= distances[1]);
        assert_float_equal(distances[0], 5, 1e-5f / steep);
        if (!disk) assert_float_equal(distances[1], 5 + v_length(v_sub(q, p)), 1e-5f / steep);
        /* An unnormalised direction, as in the space of a scaled instance. */
        float longer[2] = {0, 0};
        assert_int_equal(quadric_crossings(quadric, origin, v_scale(d, 4), longer), count);
        assert_float_equal(longer[0], 1.25f, 1e-5f / steep);
    }
    /* No line meets what is cut away. */
    for (uint32_t i = 0; i < 2000; i++) {
        vec2_t a = random_2d(i, 0), b = random_2d(i, 1), c = random_2d(i, 2);
        vec3_t o = vec3(8 * a.x - 4, 8 * a.y - 4, 8 * b.x - 4), d = vec3(b.y - 0.5f, c.x - 0.5f, c.y - 0.5f);
        o = xform_point(&quadric->record->object_from_quadric, o);
        float distances[2], low[3], high[3];
        int count = quadric_crossings(quadric, o, d, distances);
        quadric_bounds(quadric, low, high);
        for (int k = 0; k < count; k++) {
            vec3_t p = v_mad(o, distances[k], d);
            whole_point_t whole = whole_at(quadric, p);
            quadric_point_t at = whole.point;
            vec2_t uv = whole.details.uv;
            assert_near(at.p, p, 1e-4f * (1 + fabsf(distances[k]) * v_length(d)));
            assert_true(uv.x >= 0 && uv.x <= 1.00001f && uv.y >= -1e-4f && uv.y <= 1.0001f);
            assert_true(at.p.x >= low[0] && at.p.x <= high[0] && at.p.y >= low[1] && at.p.y <= high[1] &&
                        at.p.z >= low[2] && at.p.z <= high[2]);
        }
    }
}

static void lines_cross_where_they_should(void **state)
{
    (void)state;
    for_all(check_crossings);
}

/* Area by (u, v), from the derivatives that are tested above. */
static double true_area(const quadric_t *quadric)
{
    enum { SIDE = 300 };
    double sum = 0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        quadric_details_t at;
        quadric_details(quadric, point_at(quadric, (i % SIDE + 0.5) / SIDE, (i / SIDE + 0.5) / SIDE), &at);
        sum += (double)v_length(v_cross(at.dpdu, at.dpdv)) / (SIDE * SIDE);
    }
    return sum;
}

static void check_samples(const quadric_t *quadric)
{
    enum { DRAWS = 40000, SIDE = 8 };
    const blob_quadric_t *q = quadric->record;
    double observed[SIDE * SIDE] = {0}, expected[SIDE * SIDE], inverse_pdf = 0, squares = 0;
    for (uint32_t i = 0; i < DRAWS; i++) {
        quadric_point_t at, same;
        quadric_sample(quadric, random_2d(i, 0), &at);
        quadric_at(quadric, at.p, &same);
        assert_near(at.p, same.p, 1e-4f);
        assert_near(at.n, same.n, 1e-3f);
        assert_float_equal(quadric_pdf(quadric, &at) / quadric_pdf(quadric, &same), 1, 1e-3f);
        vec3_t local = xform_point(&quadric->quadric_from_object, at.p);
        double r2 = (double)(local.x * local.x + local.y * local.y), inner = q->inner_radius,
               outer = q->radius;
        double along = q->kind == QUADRIC_DISK ? (r2 - inner * inner) / (outer * outer - inner * inner)
                                               : (double)(local.z - q->z_min) / (double)(q->z_max - q->z_min);
        int column = int_min((int)(whole_at(quadric, at.p).details.uv.x * SIDE), SIDE - 1),
            row = (int)(along * SIDE);
        observed[int_max(0, int_min(row, SIDE - 1)) * SIDE + column]++;
        double area = 1 / (double)quadric_pdf(quadric, &at);
        inverse_pdf += area / DRAWS;
        squares += area * area / DRAWS;
    }
    for (int i = 0; i < SIDE * SIDE; i++) expected[i] = (double)DRAWS / (SIDE * SIDE);
    double p = chi_square_p(observed, expected, (size_t)SIDE * SIDE, DRAWS);
    if (!(p > 1e-4)) fail_msg("kind %u: p = %g", q->kind, p);
    double truth = true_area(quadric), error = sqrt(fmax(0, squares - inverse_pdf * inverse_pdf) / DRAWS);
    if (!(fabs(inverse_pdf - truth) < 5 * error + 1e-3 * truth))
        fail_msg("kind %u: area %g by the density, %g in truth", q->kind, inverse_pdf, truth);
    /* Exact for even scales, of the right size for any. */
    bool even = q->object_from_quadric.m[0][1] == 0;
    double area = quadric->area;
    if (!(fabs(area - truth) < (even ? 1e-3 : 0.7) * truth))
        fail_msg("kind %u: area %g, %g in truth", q->kind, area, truth);
}

static void samples_are_even(void **state)
{
    (void)state;
    for_all(check_samples);
}

/* A scene of pbrt text. */
typedef struct {
    char *folder;
    uint8_t *bytes;
    scene_blob_t blob;
    scene_t *scene;
} written_t;

static void begin(written_t *w, const char *world)
{
    w->folder = scratch_new();
    char *path = scratch_path(w->folder, "scene.pbrt");
    char *text = mem_printf("Camera \"perspective\"\nFilm \"image\"\nWorldBegin\n%sWorldEnd\n", world);
    scratch_write(path, text, strlen(text));
    uint64_t size;
    result_t made = import_scene_blob(path, NULL, &w->bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(w->bytes, size, &w->blob).code, RESULT_OK);
    assert_int_equal(scene_new(&w->blob, &w->scene).code, RESULT_OK);
    free(text);
    free(path);
}

static void end(written_t *w)
{
    scene_destroy(&w->scene);
    free(w->bytes);
    scratch_destroy(&w->folder);
}

/* Round things stay round in scaled instances: the normal of a sphere of radius r is its point / r. */
static void instances_scale_curvature(void **state)
{
    (void)state;
    written_t w;
    begin(&w, "ObjectBegin \"a\"\nShape \"sphere\" \"float radius\" [2]\nObjectEnd\n"
              "Scale -3 3 3\nObjectInstance \"a\"\n");
    for (uint32_t i = 0; i < 100; i++) {
        vec2_t u = random_2d(i, 0), v = random_2d(i, 1);
        vec3_t origin = vec3(20 * u.x - 10, 20 * u.y - 10, 8 * v.x + 8);
        surface_t surface;
        surface_details_t details;
        assert_true(scene_intersect(w.scene, origin, v_neg(v_normalize(origin)), 0, &surface));
        scene_details(w.scene, &surface, &details);
        assert_near(surface.ng, v_scale(surface.p, 1 / 6.0f), 1e-4f);
        assert_near(details.dndu, v_scale(details.dpdu, 1 / 6.0f), 1e-4f);
        assert_near(details.dndv, v_scale(details.dpdv, 1 / 6.0f), 1e-4f);
    }
    end(&w);
}

/* The ground of many a scene is a huge sphere; and what is placed may have been made far away. Points near
 * the origin are rounded by numbers that are far larger than their own, and yet rays leave the surface. */
static void large_things_do_not_hide_the_sky(void **state)
{
    (void)state;
    static const char *const worlds[] = {
        "Translate 0 -1000 0\nShape \"sphere\" \"float radius\" [1000]\n",
        "Translate 1 -5000 2\nRotate 30 1 2 3\nScale 3 2 1\nShape \"sphere\" \"float radius\" [2000]\n",
        "ObjectBegin \"a\"\nTranslate 1000 500 300\nRotate 40 1 0 1\nShape \"trianglemesh\" "
        "\"integer indices\" [0 1 2] \"point P\" [-50 0 -50  50 0 -50  0 0 50]\nObjectEnd\n"
        "Translate -1000 -500 -300\nObjectInstance \"a\"\n",
        "ObjectBegin \"a\"\nTranslate 0 -600 0\nShape \"sphere\" \"float radius\" [500]\nObjectEnd\n"
        "Translate 0 100 0\nObjectInstance \"a\"\n"};
    for (size_t k = 0; k < ARRAY_LENGTH(worlds); k++) {
        written_t w;
        begin(&w, worlds[k]);
        int met = 0, hidden = 0;
        for (uint32_t i = 0; i < 2000; i++) {
            vec2_t u = random_2d(i, 0), v = random_2d(i, 1);
            vec3_t origin = vec3(0.3f, 4, 0.2f), towards = vec3(3 * u.x - 1.5f, -4, 3 * u.y - 1.5f);
            surface_t surface;
            if (!scene_intersect(w.scene, origin, v_normalize(towards), 0, &surface)) continue;
            vec3_t s, t, out = v_dot(surface.ng, towards) < 0 ? surface.ng : v_neg(surface.ng);
            v_frame(out, &s, &t);
            float height = 0.02f + 0.98f * v.x, across = sqrtf(1 - height * height), angle = 6.28f * v.y;
            vec3_t ray = v_add(v_scale(out, height),
                               v_add(v_scale(s, across * cosf(angle)), v_scale(t, across * sinf(angle))));
            met++;
            hidden += scene_probe(w.scene, scene_offset(&surface, ray), ray);
        }
        print_message("world %zu: of %d rays %d meet what they left\n", k, met, hidden);
        assert_true(met > 500);
        assert_int_equal(hidden, 0);
        end(&w);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_have_their_derivatives),
        cmocka_unit_test(lines_cross_where_they_should),
        cmocka_unit_test(samples_are_even),
        cmocka_unit_test(instances_scale_curvature),
        cmocka_unit_test(large_things_do_not_hide_the_sky),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
