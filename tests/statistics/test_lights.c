/* The ways to a light (light.h) against one another, for every kind of light: light that falls on a small
 * disc, found by drawing places, by tracing light subpaths, and by looking in all directions; and the
 * densities that each way claims, found by what the others do. */
#include "client/import/import.h"
#include "common/sampler.h"
#include "tests/scratch.h"
#include "worker/render/light/light.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static char *folder;

/* ---- lights -------------------------------------------------------------------------------------------- */

/* Specks that give the scene a size. */
#define SPECK(p) "AttributeBegin\nTranslate " p "\nShape \"sphere\" \"float radius\" [0.01]\nAttributeEnd\n"
#define HEAD(film)                                                                                           \
    "Camera \"perspective\"\nFilm \"" film "\" \"integer xresolution\" [16] \"integer yresolution\" [16]\n"  \
    "WorldBegin\n" SPECK("2 2 2") SPECK("-2 -2 -2")
#define V3(world) HEAD("image") world "WorldEnd\n"
#define V4(world) HEAD("rgb") world
#define AREA3(more) "AreaLightSource \"diffuse\" \"rgb L\" [3 2 1] " more "\n"
#define QUAD                                                                                                 \
    "\"integer indices\" [0 1 2 0 2 3] \"point3 P\" [-0.5 1.4 -0.5 0.5 1.6 -0.5 0.5 1.5 0.7 -0.5 1.4 0.5]"
#define TWO_QUADS                                                                                            \
    "Shape \"trianglemesh\" " QUAD "\nTranslate 0.4 0.1 -0.2\nRotate 10 1 0 1\nShape \"trianglemesh\" " QUAD \
    "\n"                                                                                                     \
    "Translate -0.3 0.1 0.3\n"
#define PLACE "Translate 0.2 1.1 0.1\nRotate 70 1 0.3 0.2\n"
#define STRETCH "Scale 0.5 0.3 0.8\n"

/* A light, and which ways lead to it. */
enum {
    FOUND_BY_LOOKING = 1,
    LETS_THROUGH = 2 /* looks pass it by chance, so that they do not measure its densities */
};
typedef struct {
    const char *name, *text;
    int flags;
} light_case_t;

static const light_case_t lights_of[] = {
    {"mesh", V3(AREA3("") "Shape \"trianglemesh\" " QUAD "\n"), FOUND_BY_LOOKING},
    {"mesh, two sides, turned",
     V3("ReverseOrientation\n" AREA3("\"bool twosided\" [\"true\"]") "Shape \"trianglemesh\" " QUAD "\n"),
     FOUND_BY_LOOKING},
    {"mesh with normals, turned away", /* what they tell is the side that shines: up; ReverseOrientation: down
                                        */
     V3("ReverseOrientation\n" AREA3("") "Shape \"trianglemesh\" " QUAD
                                         " \"normal N\" [0 1 0 0.2 1 0 0 1 0.2 0 1 0]\n"),
     FOUND_BY_LOOKING},
    {"mesh, mirrored", V3("Scale 1 1 -1\n" AREA3("") "Shape \"trianglemesh\" " QUAD "\n"), FOUND_BY_LOOKING},
    {"sphere", V3(PLACE AREA3("") "Shape \"sphere\" \"float radius\" [0.4]\n"), FOUND_BY_LOOKING},
    {"sphere, stretched", V3(PLACE STRETCH AREA3("") "Shape \"sphere\"\n"), FOUND_BY_LOOKING},
    {"sphere, mirrored", V3(PLACE "Scale -0.5 0.3 0.8\n" AREA3("") "Shape \"sphere\"\n"), FOUND_BY_LOOKING},
    {"sphere, part, inside out",
     V3(PLACE STRETCH "ReverseOrientation\n" AREA3(
         "") "Shape \"sphere\" \"float zmin\" [-0.4] \"float zmax\" [0.7] \"float phimax\" [230]\n"),
     FOUND_BY_LOOKING},
    {"sphere, part, two sides",
     V3(PLACE STRETCH AREA3(
         "\"bool twosided\" [\"true\"]") "Shape \"sphere\" \"float zmax\" [0.3] \"float phimax\" [250]\n"),
     FOUND_BY_LOOKING},
    {"disk", V3(PLACE AREA3("") "Shape \"disk\" \"float radius\" [0.6]\n"), FOUND_BY_LOOKING},
    {"ring, part, stretched, two sides",
     V3(PLACE STRETCH AREA3("\"bool twosided\" [\"true\"]") "Shape \"disk\" \"float height\" [0.3] \"float "
                                                            "innerradius\" [0.3] \"float phimax\" [200]\n"),
     FOUND_BY_LOOKING},
    {"cylinder", V3(PLACE AREA3("") "Shape \"cylinder\" \"float radius\" [0.3]\n"), FOUND_BY_LOOKING},
    {"cylinder, part, stretched, two sides",
     V3(PLACE STRETCH AREA3(
         "\"bool twosided\" [\"true\"]") "Shape \"cylinder\" \"float zmin\" [-0.5] \"float "
                                         "phimax\" [220]\n"),
     FOUND_BY_LOOKING},
    {"mesh with an image",
     V4("AreaLightSource \"diffuse\" \"string filename\" \"square.pfm\"\nShape \"trianglemesh\" " QUAD
        " \"point2 uv\" [0 0 1 0 1 1 0 1]\n"),
     FOUND_BY_LOOKING},
    {"sphere with an image",
     V4(PLACE STRETCH "AreaLightSource \"diffuse\" \"string filename\" \"square.pfm\"\nShape \"sphere\" "
                      "\"float zmax\" [0.5]\n"),
     FOUND_BY_LOOKING},
    {"mesh, half there",
     V4("AreaLightSource \"diffuse\" \"rgb L\" [3 2 1]\nShape \"trianglemesh\" \"float alpha\" [0.6] " QUAD
        "\n"),
     FOUND_BY_LOOKING | LETS_THROUGH},
    {"constant sky", V3("LightSource \"infinite\" \"rgb L\" [3 2 1]\n"), FOUND_BY_LOOKING},
    {"lat-long sky",
     V3("Rotate 50 1 0.3 0.2\nLightSource \"infinite\" \"rgb L\" [3 2 1] \"string mapname\" "
        "[\"wide.pfm\"]\n"),
     FOUND_BY_LOOKING},
    {"lat-long sky, stretched and mirrored",
     V3("Rotate 50 1 0.3 0.2\nScale 1 -2 0.7\nLightSource \"infinite\" \"string mapname\" [\"wide.pfm\"]\n"),
     FOUND_BY_LOOKING},
    {"octahedral sky",
     V4("Rotate 50 1 0.3 0.2\nLightSource \"infinite\" \"string filename\" \"square.pfm\"\n"),
     FOUND_BY_LOOKING},
    {"sky through a portal",
     V4("Rotate 50 1 0.3 0.2\nLightSource \"infinite\" \"string filename\" \"square.pfm\" \"point3 portal\" "
        "[-0.7 1.2 -0.6  0.7 1.2 -0.6  0.7 1.2 0.6  -0.7 1.2 0.6]\n"),
     FOUND_BY_LOOKING},
    {"many",
     V3("LightSource \"infinite\" \"rgb L\" [0.3 0.2 0.1]\nLightSource \"infinite\" \"string mapname\" "
        "[\"wide.pfm\"]\n" AREA3(
            "") "Shape \"trianglemesh\" " QUAD
                "\n" PLACE AREA3("") "Shape \"sphere\" \"float radius\" [0.2]\nTranslate 0.7 0 0\n" AREA3(
                    "") "Shape \"disk\" \"float radius\" [0.3]\n"),
     FOUND_BY_LOOKING},
    {"mesh of many triangles",
     V3(AREA3("\"bool twosided\" [\"true\"]") "Shape \"loopsubdiv\" \"integer levels\" [3] " QUAD "\n"),
     FOUND_BY_LOOKING},
    {"more than are asked", V3(AREA3("") TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS),
     FOUND_BY_LOOKING},
    {"more than are asked, under two skies",
     V3("LightSource \"infinite\" \"rgb L\" [0.3 0.2 0.1]\nLightSource \"infinite\" \"string mapname\" "
        "[\"wide.pfm\"]\n" AREA3("") TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS),
     FOUND_BY_LOOKING},
    {"more than are asked, and the sun",
     V3("LightSource \"distant\" \"point from\" [0.3 2 0.4] \"point to\" [0 0 0]\n" AREA3("")
            TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS TWO_QUADS),
     0},
    {"point", V3("LightSource \"point\" \"point from\" [0.3 1.2 0.2]\n"), 0},
    {"spot of v3",
     V3("LightSource \"spot\" \"point from\" [0.3 1.2 0.2] \"point to\" [0.1 0 0.2] \"float coneangle\" [25] "
        "\"float conedeltaangle\" [20]\n"),
     0},
    {"spot of v4",
     V4("LightSource \"spot\" \"point3 from\" [0.3 1.2 0.2] \"point3 to\" [0.1 0 0.2] \"float coneangle\" "
        "[120] "
        "\"float conedeltaangle\" [110]\n"),
     0},
    {"goniometric of v3",
     V3(PLACE "LightSource \"goniometric\" \"rgb I\" [3 2 1] \"string mapname\" [\"wide.pfm\"]\n"), 0},
    {"goniometric of v4",
     V4(PLACE "LightSource \"goniometric\" \"rgb I\" [3 2 1] \"string filename\" \"square.pfm\"\n"), 0},
    {"goniometric, stretched",
     V3(PLACE STRETCH "LightSource \"goniometric\" \"rgb I\" [3 2 1] \"string mapname\" [\"wide.pfm\"]\n"),
     0},
    {"projection of v3",
     V3("Translate 0.1 1.2 0\nRotate 80 1 0 0.1\nLightSource \"projection\" \"float fov\" [40] \"string "
        "mapname\" "
        "[\"wide.pfm\"]\n"),
     0},
    {"projection of v4, stretched",
     V4("Translate 0.1 1.2 0\nRotate 80 1 0 0.1\nScale -1 1.5 0.8\nLightSource \"projection\" \"float fov\" "
        "[60] "
        "\"string filename\" \"square.pfm\"\n"),
     0},
    {"distant", V3("LightSource \"distant\" \"point from\" [0.3 1.2 0.2]\n"), 0},
    {"many of no extent",
     V3("LightSource \"distant\" \"rgb L\" [0.3 0.2 0.1] \"point from\" [0.3 1.2 0.2]\nLightSource \"point\" "
        "\"rgb "
        "I\" [1 2 3] \"point from\" [0.3 1.2 0.2]\nLightSource \"spot\" \"point from\" [0.3 1.2 0.2] \"point "
        "to\" "
        "[0.1 0 0.2] \"float coneangle\" [25]\n"),
     0},
};

/* ---- estimates ----------------------------------------------------------------------------------------- */

/* Means of what is added, `draws` of each. */
enum { CELL_ROWS = 6, CELL_COLUMNS = 8, CELLS = CELL_ROWS * CELL_COLUMNS };
enum { IRRADIANCE_RED, IRRADIANCE_BLUE, CROSSINGS, FIRST_PLACE, FIRST_RAY = FIRST_PLACE + CELLS };
enum { QUANTITIES = FIRST_RAY + CELLS };
typedef struct {
    double sum[QUANTITIES], squares[QUANTITIES], draws;
} tally_t;

static void add(tally_t *tally, int quantity, double value)
{
    tally->sum[quantity] += value;
    tally->squares[quantity] += value * value;
}

static double mean_of(const tally_t *tally, int quantity, double *variance)
{
    double mean = tally->sum[quantity] / tally->draws;
    *variance = fmax(0, tally->squares[quantity] / tally->draws - mean * mean) / tally->draws;
    return mean;
}

/* Equal solid angles: rows in z, columns in phi. */
static int cell_of(vec3_t w)
{
    int row = int_min((int)((double)(w.z + 1) * 0.5 * CELL_ROWS), CELL_ROWS - 1);
    double phi = atan2((double)w.y, (double)w.x) / (2 * M_PI) + 0.5;
    return row * CELL_COLUMNS + int_min((int)(phi * CELL_COLUMNS), CELL_COLUMNS - 1);
}

/* The disc that catches light, and whose middle looks about. */
static const vec3_t centre = {0.2f, 0.1f, -0.1f};
static const float radius = 0.4f;
static vec3_t normal(void)
{
    return v_normalize(vec3(0.2f, 1, 0.3f));
}
static float disc_area(void)
{
    return PI_F * radius * radius;
}
static vec3_t point_of_disc(vec2_t u)
{
    vec3_t s, t;
    vec2_t d = warp_disc(u);
    v_frame(normal(), &s, &t);
    return v_mad(v_mad(centre, radius * d.x, s), radius * d.y, t);
}

typedef struct {
    scene_t *scene;
    lights_t *lights;
    float share; /* of the draws that trace a light subpath */
} lit_t;

/* How often light subpaths start at the place for once that it is drawn. */
static double starts(const light_view_t *view)
{
    return (double)(view->pdf_place / view->density);
}

/* Draws places: s = 1. */
static void by_places(const lit_t *lit, uint32_t i, tally_t *tally)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
    float choice = sampler_1d(&sampler);
    vec2_t place = sampler_2d(&sampler);
    vec3_t point = point_of_disc(sampler_2d(&sampler));
    light_view_t view;
    tally->draws++;
    if (lights_illuminate(lit->lights, point, choice, place, &view) &&
        !scene_occluded(lit->scene, point, view.target, 0, false)) {
        assert_true(view.pdf_place > 0 && view.geometry > 0 && view.arrival >= 0);
        assert_float_equal(v_length(view.w), 1, 1e-5f);
        float cos = v_dot(view.w, normal());
        double factor = (double)(float_max(cos, 0) * view.geometry / view.density);
        add(tally, IRRADIANCE_RED, factor * (double)view.radiance.x);
        add(tally, IRRADIANCE_BLUE, factor * (double)view.radiance.z);
        add(tally, CROSSINGS, (double)(view.arrival * fabsf(cos) * disc_area()) * starts(&view));
    }
    if (!lights_illuminate(lit->lights, centre, choice, place, &view) ||
        scene_occluded(lit->scene, centre, view.target, 0, false))
        return;
    add(tally, FIRST_PLACE + cell_of(view.w), (double)view.geometry * starts(&view));
    add(tally, FIRST_RAY + cell_of(view.w), (double)view.arrival * starts(&view));
}

/* Draws the places that a first vertex is joined to: s = 1 with t = 2. */
static void by_first_places(const lit_t *lit, uint32_t i, tally_t *tally)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
    float choice = sampler_1d(&sampler);
    vec3_t point = point_of_disc(sampler_2d(&sampler));
    light_view_t view;
    vec2_t pairs[LIGHTS_FIRST_MOST];
    double red = 0, blue = 0, places[CELLS] = {0}; /* of one draw */
    for (int k = 0; k < LIGHTS_FIRST_MOST; k++) pairs[k] = sampler_2d(&sampler);
    tally->draws++;
    assert_true(lights_first_count(lit->lights) <= LIGHTS_FIRST_MOST);
    for (uint32_t k = 0; k < lights_first_count(lit->lights); k++) {
        assert_true(lights_first_pair(lit->lights, k) < LIGHTS_FIRST_MOST);
        vec2_t place = pairs[lights_first_pair(lit->lights, k)];
        if (lights_illuminate_first(lit->lights, k, point, choice, place, &view) &&
            !scene_occluded(lit->scene, point, view.target, 0, false)) {
            float ratio = view.view_ratio * lights_first_times(lit->lights, view.light);
            assert_float_equal(view.density, view.pdf_place * ratio, 1e-5f * view.density);
            float factor = float_max(v_dot(view.w, normal()), 0) * view.geometry / view.density;
            red += (double)(factor * view.radiance.x);
            blue += (double)(factor * view.radiance.z);
        }
        if (lights_illuminate_first(lit->lights, k, centre, choice, place, &view) &&
            !scene_occluded(lit->scene, centre, view.target, 0, false))
            places[cell_of(view.w)] += (double)view.geometry * starts(&view);
    }
    add(tally, IRRADIANCE_RED, red);
    add(tally, IRRADIANCE_BLUE, blue);
    for (int c = 0; c < CELLS; c++) add(tally, FIRST_PLACE + c, places[c]);
}

/* Traces light subpaths: s >= 2. Their rays cross the disc, if nothing stops them before. */
static void by_rays(const lit_t *lit, uint32_t i, tally_t *tally)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 2, 0, i);
    float choice = sampler_1d(&sampler);
    vec2_t place = sampler_2d(&sampler);
    light_ray_t ray;
    tally->draws++;
    if (sampler_2d(&(sampler_t){.sample_key = sampler.sample_key, .dimension = 9}).x >= lit->share) return;
    if (!lights_emit(lit->lights, choice, place, sampler_2d(&sampler), &ray)) return;
    assert_true(ray.pdf_place > 0 && ray.pdf_ray > 0);
    assert_float_equal(v_length(ray.direction), 1, 1e-5f);
    float cos = v_dot(ray.direction, normal());
    float distance = v_dot(v_sub(centre, ray.origin), normal()) / cos;
    if (!(distance > 0)) return;
    vec3_t crossing = v_mad(ray.origin, distance, ray.direction);
    if (!(v_length(v_sub(crossing, centre)) <= radius) ||
        scene_occluded(lit->scene, ray.origin, crossing, 0, false))
        return;
    add(tally, CROSSINGS, 1);
    if (cos > 0) return;
    add(tally, IRRADIANCE_RED, (double)(ray.throughput.x / disc_area()));
    add(tally, IRRADIANCE_BLUE, (double)(ray.throughput.z / disc_area()));
}

/* Runs into lights: s = 0. What they say of the densities is per steradian at the disc. */
static void add_found(tally_t *tally, const light_hit_t *hit, float cos, vec3_t w, bool in_middle,
                      double per_ray)
{
    double sphere = 4 * M_PI;
    if (in_middle) {
        add(tally, FIRST_PLACE + cell_of(w), sphere * (double)hit->pdf_place);
        add(tally, FIRST_RAY + cell_of(w), sphere * (double)(hit->pdf_place * hit->pdf_ray) / per_ray);
        return;
    }
    add(tally, IRRADIANCE_RED, sphere * (double)(float_max(cos, 0) * hit->radiance.x));
    add(tally, IRRADIANCE_BLUE, sphere * (double)(float_max(cos, 0) * hit->radiance.z));
}

static void look(const lit_t *lit, vec3_t point, vec3_t w, bool in_middle, tally_t *tally)
{
    surface_t surface;
    light_hit_t hit;
    float cos = v_dot(w, normal());
    if (!scene_intersect(lit->scene, point, w, 0, &surface)) {
        for (uint32_t k = 0; k < lights_sky_count(lit->lights); k++)
            if (lights_escape(lit->lights, k, point, w, &hit)) add_found(tally, &hit, cos, w, in_middle, 1);
    } else if (surface.light != BLOB_NONE && lights_hit(lit->lights, point, &surface, v_neg(w), &hit)) {
        add_found(tally, &hit, cos, w, in_middle, fabs((double)v_dot(surface.ng, w)));
    }
}

static void by_looking(const lit_t *lit, uint32_t i, tally_t *tally)
{
    sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
    vec3_t point = point_of_disc(sampler_2d(&sampler)), w = warp_sphere(sampler_2d(&sampler));
    tally->draws++;
    look(lit, point, w, false, tally);
    look(lit, centre, w, true, tally);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

/* How many standard errors lie between two means. */
static double z_of(const tally_t *a, const tally_t *b, int quantity)
{
    double variance_a, variance_b;
    double difference = mean_of(a, quantity, &variance_a) - mean_of(b, quantity, &variance_b);
    double slack = 2e-4 * mean_of(a, quantity, &(double){0}); /* rounding */
    return difference / sqrt(variance_a + variance_b + slack * slack + 1e-20);
}

static bool compare(const char *name, const char *ways, const tally_t *a, const tally_t *b, int first,
                    int last)
{
    double largest = 0, squares = 0;
    int used = 0, worst = first;
    for (int q = first; q <= last; q++) {
        double z = z_of(a, b, q);
        /* Cells that few draws fell into have no error to speak of. */
        double expected = fmax(a->sum[q] * a->sum[q] / fmax(a->squares[q], 1e-300), 0);
        if (last > first && (expected < 200 || b->sum[q] * b->sum[q] / fmax(b->squares[q], 1e-300) < 200))
            continue;
        used++;
        squares += z * z;
        if (fabs(z) > largest) largest = fabs(z), worst = q;
    }
    /* Cells are many thousands in all, single quantities some hundreds. */
    bool holds = largest < (last > first ? 5 : 4) && (used < 8 || sqrt(squares / used) < 1.6);
    if (!holds) {
        double unused;
        print_message("%s: %s differ in quantity %d: %g, %g, z = %.1f, rms of %d %.2f\n", name, ways, worst,
                      mean_of(a, worst, &unused), mean_of(b, worst, &unused), largest, used,
                      sqrt(squares / int_max(used, 1)));
    }
    return holds;
}

static bool check_ways(const char *name, int flags, const lit_t *lit)
{
    enum { PLACES = 40000, RAYS = 120000, LOOKS = 80000 };
    tally_t *tallies = mem_zalloc(4, sizeof *tallies);
    for (uint32_t i = 0; i < PLACES; i++) by_places(lit, i, &tallies[0]);
    for (uint32_t i = 0; i < PLACES; i++) by_first_places(lit, i, &tallies[3]);
    for (uint32_t i = 0; i < RAYS; i++) by_rays(lit, i, &tallies[1]);
    bool holds = tallies[0].sum[IRRADIANCE_RED] > 0;
    if (!holds) print_message("%s: no light\n", name);
    for (int q = IRRADIANCE_RED; q <= CROSSINGS; q++)
        holds = compare(name, "places and rays", &tallies[0], &tallies[1], q, q) && holds;
    for (int q = IRRADIANCE_RED; q <= IRRADIANCE_BLUE; q++)
        holds = compare(name, "places and first places", &tallies[0], &tallies[3], q, q) && holds;
    holds =
        compare(name, "densities of first places", &tallies[0], &tallies[3], FIRST_PLACE, FIRST_RAY - 1) &&
        holds;
    const tally_t *a = &tallies[0], *b = &tallies[2];
    if (flags & FOUND_BY_LOOKING) {
        for (uint32_t i = 0; i < LOOKS; i++) by_looking(lit, i, &tallies[2]);
        holds = compare(name, "places and looks", a, b, IRRADIANCE_RED, IRRADIANCE_RED) && holds;
        holds = compare(name, "places and looks", a, b, IRRADIANCE_BLUE, IRRADIANCE_BLUE) && holds;
    }
    if (flags == FOUND_BY_LOOKING) {
        holds = compare(name, "densities of places", a, b, FIRST_PLACE, FIRST_RAY - 1) && holds;
        holds = compare(name, "densities of rays", a, b, FIRST_RAY, QUANTITIES - 1) && holds;
    }
    double unused;
    print_message("%-40s irradiance %.4f %.4f\n", name, mean_of(&tallies[0], IRRADIANCE_RED, &unused),
                  mean_of(&tallies[1], IRRADIANCE_RED, &unused));
    free(tallies);
    return holds;
}

/* The lights with guides by lessons that nobody gave: whatever was learned, the ways agree. */
static lit_t guide(const lit_t *lit, uint32_t room)
{
    double *lessons = mem_alloc(room * sizeof *lessons);
    for (uint32_t i = 0; i < room; i++) {
        double u = (double)(sampler_mix(i + 1) >> 11) * 0x1p-53;
        lessons[i] = u < 0.3 ? 0 : u * u * u;
    }
    lit_t guided = *lit;
    lights_learn(lit->lights, room);
    guided.lights = lights_guided(lit->lights, lessons, 100, 0, 1, 0.6, &guided.share);
    assert_float_equal(guided.share, 0.6f, 1e-6f);
    free(lessons);
    return guided;
}

/* What a look against a ray of a light says of the ray's start; false when it does not find the light. */
static bool look_back(const lit_t *lit, const light_ray_t *ray, light_hit_t *hit)
{
    surface_t surface;
    vec3_t point = v_mad(ray->origin, 0.01f, ray->direction), w = v_neg(ray->direction);
    if (!ray->at_infinity)
        return scene_intersect(lit->scene, point, w, 0, &surface) && surface.light == ray->light &&
               lights_hit(lit->lights, point, &surface, ray->direction, hit);
    for (uint32_t k = 0; k < lights_sky_count(lit->lights); k++)
        if (lights_escape(lit->lights, k, point, w, hit) && hit->light == ray->light) return true;
    return false;
}

/* Eye subpaths that run into a light teach where light subpaths should have started: at the same starts. */
static bool check_starts(const char *name, const lit_t *lit)
{
    int found = 0, same = 0;
    for (uint32_t i = 0; i < 2000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 5, 0, i);
        float choice = sampler_1d(&sampler);
        vec2_t place = sampler_2d(&sampler);
        light_ray_t ray;
        light_hit_t hit;
        if (!lights_emit(lit->lights, choice, place, sampler_2d(&sampler), &ray)) continue;
        if (ray.gate > 0) return true; /* lights with portals have no guide */
        if (!look_back(lit, &ray, &hit)) continue;
        found++;
        same += fabsf(hit.start.density - ray.start.density) <= 1e-3f * ray.start.density &&
                (ray.start.density == 0 || hit.lesson == 2 * ray.lessons[1] - ray.lessons[0]);
    }
    if (found >= 500 && same >= 0.98 * found) return true; /* the rest lies on the edges of cells */
    print_message("%s: of %d hits %d know the start\n", name, found, same);
    return false;
}

static bool check(const light_case_t *c)
{
    char *path = scratch_path(folder, "scene.pbrt"), guided_name[100];
    scratch_write(path, c->text, strlen(c->text));
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    lit_t lit = {.share = 1};
    result_t made = import_scene_blob(path, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s: %s", c->name, made.message);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    assert_int_equal(scene_new(&blob, &lit.scene).code, RESULT_OK);
    lit.lights = lights_new(lit.scene);
    bool holds = check_ways(c->name, c->flags, &lit);
    const uint32_t rooms[] = {120000, 9000}; /* for the finest grids, and for coarse ones alone */
    for (size_t i = 0; i < ARRAY_LENGTH(rooms); i++) {
        lit_t guided = guide(&lit, rooms[i]);
        snprintf(guided_name, sizeof guided_name, "%s, guided by %u lessons", c->name, rooms[i]);
        holds = check_ways(guided_name, c->flags, &guided) && holds;
        if (c->flags == FOUND_BY_LOOKING) holds = check_starts(guided_name, &guided) && holds;
        lights_destroy(&guided.lights);
    }
    lights_destroy(&lit.lights);
    scene_destroy(&lit.scene);
    free(bytes);
    free(path);
    return holds;
}

static void ways_agree(void **state)
{
    (void)state;
    int differing = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(lights_of); i++) differing += !check(&lights_of[i]);
    assert_int_equal(differing, 0);
}

static int begin(void **state)
{
    (void)state;
    folder = scratch_new();
    scratch_write_light_image(folder, "wide.pfm", 16, 8, 3);
    scratch_write_light_image(folder, "square.pfm", 8, 8, 3);
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
        cmocka_unit_test(ways_agree),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
