/* Windows of a table, and the light that comes through a portal: densities, the three ways to it, and
 * pictures. */
#include "client/import/import.h"
#include "common/sampler.h"
#include "tests/render_here.h"
#include "tests/scratch.h"
#include "worker/render/light/light.h"
#include "worker/render/sampling/window.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static char *folder;

static vec2_t random_pair(uint32_t i, uint32_t dimension)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 17, 0, i);
    sampler.dimension = dimension;
    return sampler_2d(&sampler);
}

/* ---- windows ------------------------------------------------------------------------------------------- */

enum { WIDTH = 5, HEIGHT = 3 };
static const float weights[WIDTH * HEIGHT] = {1, 0, 2, 5, NAN, 0, 0, 0, 0, 0, 3, 1, 0, 7, -2};

static double overlap(double low, double high, int cell, int count)
{
    return fmax(0, fmin(high, (cell + 1.0) / count) - fmax(low, (double)cell / count));
}

/* Expected integral, and the share of each cell. */
static double integrate(const window_t *w, double shares[WIDTH * HEIGHT])
{
    double sum = 0;
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        double weight = weights[i] > 0 ? (double)weights[i] : 0;
        shares[i] = weight * overlap((double)w->low.x, (double)w->high.x, i % WIDTH, WIDTH) *
                    overlap((double)w->low.y, (double)w->high.y, i / WIDTH, HEIGHT);
        sum += shares[i];
    }
    for (int i = 0; i < WIDTH * HEIGHT && sum > 0; i++) shares[i] /= sum;
    return sum;
}

static void windows_are_drawn_from_by_weight(void **state)
{
    (void)state;
    enum { DRAWS = 20000 };
    static const window_t windows[] = {{{0, 0}, {1, 1}},
                                       {{0.1f, 0.1f}, {0.75f, 0.9f}},
                                       {{0.41f, 0.05f}, {0.43f, 0.2f}},
                                       {{0, 0.7f}, {1, 1}}};
    window_table_t *table = window_table_new(weights, WIDTH, HEIGHT);
    for (size_t k = 0; k < ARRAY_LENGTH(windows); k++) {
        const window_t *w = &windows[k];
        double shares[WIDTH * HEIGHT], found[WIDTH * HEIGHT] = {0}, integral = integrate(w, shares);
        assert_float_equal(window_integral(table, w) / integral, 1, 1e-6);
        for (uint32_t i = 0; i < DRAWS; i++) {
            vec2_t at = window_sample(table, w, random_pair(i, (uint32_t)k));
            assert_true(at.x >= w->low.x && at.x <= w->high.x && at.y >= w->low.y && at.y <= w->high.y);
            int cell =
                int_min((int)(at.x * WIDTH), WIDTH - 1) + WIDTH * int_min((int)(at.y * HEIGHT), HEIGHT - 1);
            assert_float_equal(window_weight(table, at), weights[cell], 0);
            assert_true(weights[cell] > 0);
            found[cell] += 1.0 / DRAWS;
        }
        for (int i = 0; i < WIDTH * HEIGHT; i++)
            assert_float_equal(found[i], shares[i], 5 * sqrt(shares[i] / DRAWS) + 1e-9);
    }
    const window_t dark = {{0, 0.4f}, {1, 0.6f}}, empty = {{0.1f, 0.1f}, {0.1f, 0.3f}};
    assert_float_equal(window_integral(table, &dark), 0, 1e-15);
    assert_float_equal(window_integral(table, &empty), 0, 1e-15);
    window_table_destroy(&table);
}

/* ---- light through a portal ---------------------------------------------------------------------------- */

#define HEAD                                                                                                 \
    "LookAt 0 1.4 -1.9  0.2 0.9 0  0 1 0\nCamera \"perspective\" \"float fov\" [70]\nFilm \"rgb\" "          \
    "\"integer xresolution\" [12] \"integer yresolution\" [12]\nSampler \"sobol\"\nIntegrator \"bdpt\" "     \
    "\"integer maxdepth\" [4]\nWorldBegin\n"
#define SKY "LightSource \"infinite\" \"string filename\" \"sky.pfm\" "
#define COLOURED "LightSource \"infinite\" \"rgb L\" [3 2 1] "
/* The opening in the room's wall at x = 2; the sky lies at +x: +y, to the last corner, cross +z. */
#define CORNERS "2 0.5 -1  2 0.5 1  2 1.7 1  2 1.7 -1"
#define PORTAL "\"point3 portal\" [" CORNERS "]\n"
#define TURNED "AttributeBegin\nRotate 40 0.3 1 0.2\n"
#define QUAD(p) "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point3 P\" [" p "]\n"
#define ROOM                                                                                                 \
    "Material \"diffuse\" \"rgb reflectance\" [0.7 0.6 0.5]\n" QUAD("-2 0 -2  2 0 -2  2 0 2  -2 0 2")        \
        QUAD("-2 2 -2  2 2 -2  2 2 2  -2 2 2") QUAD("-2 0 2  2 0 2  2 2 2  -2 2 2")                          \
            QUAD("-2 0 -2  2 0 -2  2 2 -2  -2 2 -2") QUAD("-2 0 -2  -2 2 -2  -2 2 2  -2 0 2")                \
                QUAD("2 0 -2  2 0.5 -2  2 0.5 2  2 0 2") QUAD("2 1.7 -2  2 2 -2  2 2 2  2 1.7 2")            \
                    QUAD("2 0.5 -2  2 1.7 -2  2 1.7 -1  2 0.5 -1") QUAD(                                     \
                        "2 0.5 1  2 1.7 1  2 1.7 2  2 0.5 2") "Material \"conductor\" \"float roughness\" "  \
                                                              "[0.3]\nTranslate 0.3 0.4 0.2\n"               \
                                                              "Shape \"sphere\" \"float radius\" [0.4]\n"

typedef struct {
    uint8_t *bytes;
    scene_blob_t blob;
    scene_t *scene;
    lights_t *lights;
} lit_t;

/* In place: the scene keeps the address of the blob. */
static void load(const char *text, lit_t *lit)
{
    uint64_t size;
    char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, strlen(text));
    result_t made = import_scene_blob(path, NULL, &lit->bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(lit->bytes, size, &lit->blob).code, RESULT_OK);
    assert_int_equal(scene_new(&lit->blob, &lit->scene).code, RESULT_OK);
    lit->lights = lights_new(lit->scene);
    free(path);
}

static void drop(lit_t *lit)
{
    lights_destroy(&lit->lights);
    scene_destroy(&lit->scene);
    free(lit->bytes);
}

/* In the room, close to the portal, in its corner, far away; all on the side to which it is open. */
static const vec3_t inside[] = {{0, 1, 0}, {1.9f, 1, 0.2f}, {1.95f, 0.1f, -1.9f}, {-40, 9, 20}};

/* True when the ray from p along w crosses the portal outwards; *margin: how clearly. */
static bool crosses(vec3_t p, vec3_t w, float *margin)
{
    if (!(w.x > 0)) {
        *margin = 1;
        return false;
    }
    vec3_t at = v_mad(p, (2 - p.x) / w.x, w);
    float y = 0.6f - fabsf(at.y - 1.1f), z = 1 - fabsf(at.z);
    *margin = float_min(fabsf(y), fabsf(z));
    return y > 0 && z > 0;
}

/* Over all directions, of a light that is the only one. */
static double integral_of_density(const lit_t *lit, vec3_t p)
{
    enum { SIDE = 400 };
    double sum = 0;
    vec3_t to = v_sub(vec3(2, 1.1f, 0), p);
    /* On a grid over the portal, times the steradians of each of its cells. */
    for (int i = 0; i < SIDE * SIDE; i++) {
        float y = 1.2f * ((float)(i % SIDE) + 0.5f) / SIDE - 0.6f,
              z = 2 * ((float)(i / SIDE) + 0.5f) / SIDE - 1;
        vec3_t d = v_add(to, vec3(0, y, z)), w = v_normalize(d);
        light_hit_t hit;
        double steradians = 2.4 / (SIDE * SIDE) * (double)(w.x / v_length2(d));
        if (lights_escape(lit->lights, 0, p, w, &hit)) sum += (double)hit.pdf_place * steradians;
    }
    return sum;
}

static void densities_integrate_to_one(void **state)
{
    (void)state;
    static const char *const texts[] = {HEAD COLOURED PORTAL ROOM,
                                        HEAD TURNED SKY PORTAL "AttributeEnd\n" ROOM};
    for (size_t k = 0; k < ARRAY_LENGTH(texts); k++) {
        lit_t lit;
        load(texts[k], &lit);
        for (size_t i = 0; i < ARRAY_LENGTH(inside); i++)
            assert_float_equal(integral_of_density(&lit, inside[i]), 1, 5e-3);
        drop(&lit);
    }
}

static bool near(float a, float b)
{
    return fabsf(a - b) <= 2e-3f * fabsf(b);
}

/* What is drawn for a point is what the point sees there; and light is sent to it with the same densities. */
static void ways_through_a_portal_agree(void **state)
{
    (void)state;
    lit_t lit;
    load(HEAD TURNED SKY PORTAL "AttributeEnd\n" ROOM, &lit);
    int agreeing = 0, sent = 0, all = 0;
    light_hit_t hit;
    float margin;
    for (uint32_t i = 0; i < 4000; i++) {
        light_view_t view;
        vec3_t p = inside[i % 4];
        vec2_t u = random_pair(i, 0), v = random_pair(i, 1);
        assert_true(lights_illuminate(lit.lights, p, 0.5f, u, &view));
        assert_true(crosses(p, view.w, &margin) || margin < 1e-3f);
        if (lights_escape(lit.lights, 0, p, view.w,
                          &hit)) /* but where a border of cells or pixels is close */
            agreeing += near(hit.radiance.y, view.radiance.y) && near(hit.pdf_place, view.pdf_place) &&
                        near(hit.pdf_ray, view.arrival);
        light_ray_t ray;
        assert_true(lights_emit(lit.lights, 0.5f, u, v, &ray));
        assert_true(crosses(vec3(2, 1.1f, 0), v_neg(ray.direction), &margin) || margin > 0);
        vec3_t gate = v_mad(ray.origin, ray.gate, ray.direction), y = v_mad(gate, 1.3f, ray.direction);
        assert_float_equal(gate.x, 2, 1e-4f);
        assert_true(fabsf(gate.y - 1.1f) < 0.6001f && fabsf(gate.z) < 1.0001f);
        assert_true(v_length(v_sub(ray.origin, gate)) > 3);
        float enter = lights_enter(lit.lights, ray.light, y);
        if (!lights_escape(lit.lights, 0, y, v_neg(ray.direction), &hit)) continue;
        all++;
        sent += near(hit.pdf_place, ray.pdf_place / enter) && near(hit.pdf_ray, ray.pdf_ray * enter) &&
                near(ray.throughput.y * ray.pdf_place * ray.pdf_ray, hit.radiance.y);
    }
    assert_true(agreeing > 3960 && all > 3960 && sent > 0.99 * all);
    drop(&lit);
}

static void nothing_shines_past_a_portal(void **state)
{
    (void)state;
    lit_t lit;
    load(HEAD COLOURED PORTAL ROOM, &lit);
    int seen = 0;
    for (uint32_t i = 0; i < 3000; i++) {
        light_hit_t hit;
        vec2_t u = random_pair(i, 2);
        float z = 2 * u.x - 1, r = sqrtf(1 - z * z), margin;
        vec3_t w = vec3(r * cosf(TWO_PI_F * u.y), r * sinf(TWO_PI_F * u.y), z);
        bool through = crosses(inside[1], w, &margin);
        if (margin > 1e-4f) assert_int_equal(lights_escape(lit.lights, 0, inside[1], w, &hit), through);
        seen += through;
        /* Outside, the portal is open to the other side. */
        assert_false(lights_escape(lit.lights, 0, vec3(4, 1, 0), w, &hit));
    }
    light_view_t view;
    assert_true(seen > 500);
    assert_false(lights_illuminate(lit.lights, vec3(4, 1, 0), 0.5f, (vec2_t){0.5f, 0.5f}, &view));
    assert_true(lights_enter(lit.lights, 0, vec3(4, 1, 0)) == 0);
    drop(&lit);
}

/* ---- pictures ------------------------------------------------------------------------------------------ */

/* The mean of the green of a picture. */
static double picture(const char *text, integrator_t integrator, uint32_t spp)
{
    lit_t lit;
    load(text, &lit);
    job_settings_t settings = blob_default_settings(&lit.blob);
    settings.integrator = integrator;
    settings.spp = spp;
    film_t *film = render_here(&lit.blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    double sum = 0;
    int pixels = image.width * image.height;
    for (int i = 0; i < pixels; i++) sum += (double)image.sum[3 * i + 1] / pixels;
    film_image_free(&image);
    film_destroy(&film);
    drop(&lit);
    return sum;
}

static void expect_like(double value, double reference, double tolerance)
{
    if (!(fabs(value - reference) <= tolerance * reference)) fail_msg("%g instead of %g", value, reference);
}

/* A room with one opening is lit through it, whether the light is told so or not; and a portal of one colour
 * is a black lamp in its place. */
static void rooms_look_the_same_with_a_portal(void **state)
{
    (void)state;
    static const char lamp[] = HEAD
        "AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [0 0 0]\nAreaLightSource \"diffuse\" \"rgb "
        "L\" [3 2 1]\nShape \"trianglemesh\" \"integer "
        "indices\" [0 1 2 0 2 3] \"point3 P\" [2 0.5 -1  2 0.5 1  2 1.7 1  2 1.7 -1]\nAttributeEnd\n" ROOM;
    double colour = picture(lamp, INTEGRATOR_PATH, 64);
    expect_like(picture(HEAD COLOURED PORTAL ROOM, INTEGRATOR_PATH, 64), colour, 0.02);
    expect_like(picture(HEAD COLOURED PORTAL ROOM, INTEGRATOR_BDPT, 32), colour, 0.02);
    expect_like(picture(HEAD COLOURED PORTAL ROOM, INTEGRATOR_LIGHT, 256), colour, 0.02);
    double sky = picture(HEAD TURNED SKY PORTAL "AttributeEnd\n" ROOM, INTEGRATOR_PATH, 64);
    expect_like(picture(HEAD TURNED SKY PORTAL "AttributeEnd\n" ROOM, INTEGRATOR_BDPT, 32), sky, 0.03);
    expect_like(picture(HEAD TURNED SKY PORTAL "AttributeEnd\n" ROOM, INTEGRATOR_LIGHT, 256), sky, 0.03);
    expect_like(picture(HEAD TURNED SKY "\nAttributeEnd\n" ROOM, INTEGRATOR_PATH, 256), sky, 0.04);
}

/* What is outside, and scatters the light, has none for the room. */
static void light_before_a_portal_is_lost(void **state)
{
    (void)state;
    static const char shut[] = HEAD COLOURED PORTAL ROOM
        "Material \"diffusetransmission\"\nShape \"sphere\" \"float radius\" [50]\n";
    assert_true(picture(shut, INTEGRATOR_PATH, 4) == 0);
    assert_true(picture(shut, INTEGRATOR_BDPT, 4) == 0);
    assert_true(picture(shut, INTEGRATOR_LIGHT, 16) == 0);
}

static int begin(void **state)
{
    (void)state;
    folder = scratch_new();
    scratch_write_light_image(folder, "sky.pfm", 16, 16, 3);
    return 0;
}

static int end(void **state)
{
    (void)state;
    scratch_destroy(&folder);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(windows_are_drawn_from_by_weight),  cmocka_unit_test(densities_integrate_to_one),
        cmocka_unit_test(ways_through_a_portal_agree),       cmocka_unit_test(nothing_shines_past_a_portal),
        cmocka_unit_test(rooms_look_the_same_with_a_portal), cmocka_unit_test(light_before_a_portal_is_lost),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
