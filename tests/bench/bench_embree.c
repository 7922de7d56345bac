/* bench_embree: how fast this machine is, in a unit that renderers share: millions of rays a CPU second that
 * Embree alone traces here. With it, CPU times of two machines can be compared.
 *
 * The rays are incoherent, and look for the nearest hit in a closed box around a bumpy ball of 80,000
 * triangles, one ray a call, one thread. It is the best of a few runs, since others only slow a run down.
 * Nothing of the renderer takes part, so the figure is the same before and after any change of it.
 *
 * usage: bench_embree [RUNS]     a run takes about 0.15 s; 5 by default
 */
#include "common/base.h"
#include "tests/clock.h"

#include <embree3/rtcore.h>
#include <math.h>
#include <pmmintrin.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xmmintrin.h>

enum {
    SIDE = 200,
    BALL_VERTICES = (SIDE + 1) * (SIDE + 1),
    BALL_TRIANGLES = 2 * SIDE * SIDE,
    RAYS = 1000000
};

typedef struct {
    float x, y, z;
} point_t;
typedef struct {
    uint32_t vertex[3];
} triangle_t;

typedef struct {
    point_t points[BALL_VERTICES];
    triangle_t triangles[BALL_TRIANGLES];
} ball_t;

static void fill_ball(ball_t *ball)
{
    point_t *point = ball->points;
    for (int i = 0; i <= SIDE; i++)
        for (int j = 0; j <= SIDE; j++) {
            double theta = M_PI * i / SIDE, phi = 2 * M_PI * j / SIDE;
            double r = 0.5 + 0.02 * sin(20 * theta) * sin(20 * phi);
            *point++ = (point_t){(float)(r * sin(theta) * cos(phi)), (float)(r * sin(theta) * sin(phi)),
                                 (float)(r * cos(theta))};
        }
    triangle_t *triangle = ball->triangles;
    for (uint32_t i = 0; i < SIDE; i++)
        for (uint32_t j = 0; j < SIDE; j++) {
            uint32_t v = i * (SIDE + 1) + j, w = v + SIDE + 1;
            *triangle++ = (triangle_t){{v, v + 1, w}};
            *triangle++ = (triangle_t){{v + 1, w + 1, w}};
        }
}

static const point_t box_points[8] = {{-1, -1, -1}, {1, -1, -1}, {-1, 1, -1}, {1, 1, -1},
                                      {-1, -1, 1},  {1, -1, 1},  {-1, 1, 1},  {1, 1, 1}};
static const triangle_t box_triangles[12] = {{{0, 1, 2}}, {{1, 3, 2}}, {{4, 6, 5}}, {{5, 6, 7}},
                                             {{0, 4, 1}}, {{1, 4, 5}}, {{2, 3, 6}}, {{3, 7, 6}},
                                             {{0, 2, 4}}, {{2, 6, 4}}, {{1, 5, 3}}, {{3, 5, 7}}};

static void add_mesh(RTCDevice device, RTCScene scene, const point_t *points, size_t point_count,
                     const triangle_t *triangles, size_t triangle_count)
{
    RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    memcpy(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof *points,
                                   point_count),
           points, point_count * sizeof *points);
    memcpy(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, sizeof *triangles,
                                   triangle_count),
           triangles, triangle_count * sizeof *triangles);
    rtcCommitGeometry(mesh);
    rtcAttachGeometry(scene, mesh);
    rtcReleaseGeometry(mesh);
}

/* Cheap numbers in [0, 1), so that the rays are what is measured (PCG, O'Neill 2014). */
static float cheap_number(uint32_t *state)
{
    *state = *state * 747796405u + 2891336453u;
    uint32_t word = ((*state >> ((*state >> 28) + 4)) ^ *state) * 277803737u;
    return (float)((word >> 22 ^ word) >> 8) * 0x1p-24f;
}

/* A ray from anywhere in the box to anywhere. */
static struct RTCRayHit random_ray(uint32_t *state)
{
    float z = 2 * cheap_number(state) - 1, r = sqrtf(1 - z * z), phi = 6.2831853f * cheap_number(state);
    struct RTCRayHit ray = {.ray = {.dir_x = r * cosf(phi), .dir_y = r * sinf(phi), .dir_z = z}};
    ray.ray.org_x = 1.9f * cheap_number(state) - 0.95f;
    ray.ray.org_y = 1.9f * cheap_number(state) - 0.95f;
    ray.ray.org_z = 1.9f * cheap_number(state) - 0.95f;
    ray.ray.tnear = 1e-4f;
    ray.ray.tfar = INFINITY;
    ray.ray.mask = UINT32_MAX;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    return ray;
}

/* Millions of rays a CPU second, of one run. */
static double trace(RTCScene scene)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    uint32_t state = 1, hits = 0;
    double start = clock_cpu();
    for (uint32_t i = 0; i < RAYS; i++) {
        struct RTCRayHit ray = random_ray(&state);
        rtcIntersect1(scene, &context, &ray);
        hits += ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
    }
    double seconds = clock_cpu() - start;
    if (hits < RAYS - RAYS / 1000) { /* a ray may slip through the box between two triangles, no more */
        fprintf(stderr, "bench_embree: %u of %d rays found nothing in a closed box\n", RAYS - hits, RAYS);
        exit(1);
    }
    return 1e-6 * RAYS / seconds;
}

int main(int argc, char **argv)
{
    static ball_t ball;
    int runs = argc > 1 ? atoi(argv[1]) : 5;
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
    RTCDevice device = rtcNewDevice("threads=1");
    if (device == NULL) {
        fprintf(stderr, "bench_embree: Embree cannot start: error %d\n", rtcGetDeviceError(NULL));
        return 1;
    }
    RTCScene scene = rtcNewScene(device);
    fill_ball(&ball);
    add_mesh(device, scene, ball.points, BALL_VERTICES, ball.triangles, BALL_TRIANGLES);
    add_mesh(device, scene, box_points, 8, box_triangles, 12);
    rtcCommitScene(scene);
    double best = 0;
    for (int run = 0; run < runs; run++) best = fmax(best, trace(scene));
    printf("%.2f\n", best);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    return 0;
}
