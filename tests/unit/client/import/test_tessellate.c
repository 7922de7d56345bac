/* Tessellated shapes: areas and normals against analysis, orientation, uv, topology, and what is refused. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/tessellate/tessellate.h"

#include <math.h>

static const position_t here = {"s.pbrt", 3, 5};
static const double pi = 3.14159265358979323846;

static vec3_t corner(const mesh_t *mesh, uint32_t triangle, int k)
{
    return mesh->positions[mesh->triangles[triangle].v[k]];
}

static vec3_t triangle_cross(const mesh_t *mesh, uint32_t i)
{
    vec3_t p = corner(mesh, i, 0);
    return v_cross(v_sub(corner(mesh, i, 1), p), v_sub(corner(mesh, i, 2), p));
}

static double area_of(const mesh_t *mesh)
{
    double sum = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i)
        sum += 0.5 * (double)v_length(triangle_cross(mesh, i));
    return sum;
}

/* Every mesh: indices in range, areas, unit normals that lie on `side` (1 or -1) of each triangle, uv in the
 * given range and reaching its ends. */
static void check_mesh(const mesh_t *mesh, float side, bool unit_uv)
{
    assert_true(mesh->triangle_count > 0);
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        for (int k = 0; k < 3; ++k) assert_true(mesh->triangles[i].v[k] < mesh->vertex_count);
        vec3_t n = triangle_cross(mesh, i);
        assert_true(v_length(n) > 0);
        for (int k = 0; mesh->normals && k < 3; ++k) {
            vec3_t normal = mesh->normals[mesh->triangles[i].v[k]];
            expect_near((double)v_length(normal), 1, 1e-6);
            assert_true(side * v_dot(normal, n) > 0.9f * v_length(n));
        }
    }
    if (!mesh->uvs || !unit_uv) return;
    float low = 1, high = 0;
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        vec2_t uv = mesh->uvs[i];
        assert_true(uv.x >= 0 && uv.x <= 1 && uv.y >= 0 && uv.y <= 1);
        low = float_min(low, float_min(uv.x, uv.y));
        high = float_max(high, float_max(uv.x, uv.y));
    }
    assert_true(low == 0 && high == 1);
}

#define REFUSED(call, text)                                                                                  \
    do {                                                                                                     \
        mesh_t refused = {0};                                                                                \
        result_t result_ = call;                                                                             \
        assert_int_equal(result_.code, RESULT_INPUT);                                                        \
        expect_text(result_.message, "s.pbrt:3:5: ");                                                        \
        expect_text(result_.message, text);                                                                  \
        mesh_free(&refused);                                                                                 \
    } while (0)

#define ACCEPTED(call) assert_string_equal((call).message, "")

/* ---- surfaces of revolution ---------------------------------------------------------------------------- */

static void a_cone_has_its_area_and_normals(void **state)
{
    (void)state;
    for (int part = 0; part < 2; ++part) {
        cone_t cone = {2, 3, part ? 90 : 400};
        mesh_t mesh = {0};
        ACCEPTED(tessellate_cone(&cone, here, &mesh));
        check_mesh(&mesh, 1, true);
        double whole = pi * 2 * sqrt(13.0);
        expect_near(area_of(&mesh), part ? whole / 4 : whole, 2e-4 * whole);
        for (uint32_t i = 0; i < mesh.vertex_count; ++i) {
            vec3_t p = mesh.positions[i], n = mesh.normals[i];
            double phi = (double)mesh.uvs[i].x * (part ? pi / 2 : 2 * pi);
            expect_near(hypot((double)p.x, (double)p.y), 2 * (1 - (double)p.z / 3), 1e-6);
            expect_near((double)mesh.uvs[i].y, (double)p.z / 3, 1e-6);
            expect_vec3(n, 3 / sqrt(13.0) * cos(phi), 3 / sqrt(13.0) * sin(phi), 2 / sqrt(13.0));
        }
        mesh_free(&mesh);
    }
    REFUSED(tessellate_cone(&(cone_t){0, 1, 360}, here, &refused), "radius is 0");
    REFUSED(tessellate_cone(&(cone_t){1, -1, 360}, here, &refused), "height is -1");
    REFUSED(tessellate_cone(&(cone_t){1, 1, 0}, here, &refused), "phimax is 0");
    REFUSED(tessellate_cone(&(cone_t){1, NAN, 360}, here, &refused), "height is nan");
}

/* Area of z = h (r / R)^2 from z0 to z1: (pi R^4 / 6 h^2) ((1 + 4 h z / R^2)^1.5) between the ends. */
static double paraboloid_area(double radius, double h, double z0, double z1)
{
    double k = 4 * h / (radius * radius);
    return pi * pow(radius, 4) / (6 * h * h) * (pow(1 + k * z1, 1.5) - pow(1 + k * z0, 1.5));
}

static void a_paraboloid_has_its_area_and_normals(void **state)
{
    (void)state;
    static const double ranges[][2] = {{0, 2}, {2, 0.5}, {-1, 2}};
    for (int i = 0; i < 3; ++i) {
        paraboloid_t paraboloid = {1.5, ranges[i][0], ranges[i][1], 360};
        mesh_t mesh = {0};
        ACCEPTED(tessellate_paraboloid(&paraboloid, here, &mesh));
        check_mesh(&mesh, 1, i < 2);
        double low = fmax(fmin(ranges[i][0], ranges[i][1]), 0), whole = paraboloid_area(1.5, 2, low, 2);
        expect_near(area_of(&mesh), whole, 2e-4 * whole);
        for (uint32_t k = 0; k < mesh.vertex_count; ++k) {
            vec3_t p = mesh.positions[k], n = mesh.normals[k];
            expect_near((double)p.z, 2 * (double)(p.x * p.x + p.y * p.y) / 2.25, 2e-6);
            vec3_t gradient = v_normalize(vec3(4 * p.x / 2.25f, 4 * p.y / 2.25f, -1));
            expect_near((double)v_dot(n, gradient), 1, 1e-6);
        }
        mesh_free(&mesh);
    }
    mesh_t below = {0};
    ACCEPTED(tessellate_paraboloid(&(paraboloid_t){1, -2, -1, 180}, here, &below));
    check_mesh(&below, 1, true);
    mesh_free(&below);
    REFUSED(tessellate_paraboloid(&(paraboloid_t){1, 1, 1, 360}, here, &refused), "zmin 1 to zmax 1");
    REFUSED(tessellate_paraboloid(&(paraboloid_t){1, -1, 0, 360}, here, &refused), "zmax must not be 0");
    REFUSED(tessellate_paraboloid(&(paraboloid_t){-1, 0, 1, 360}, here, &refused), "radius is -1");
}

/* 2 pi times the integral of |dp/du x dp/dv| along the ruling, by the midpoint rule. */
static double hyperboloid_area(const hyperboloid_t *h)
{
    double sum = 0, d[3];
    enum { STEPS = 20000 };
    for (int k = 0; k < 3; ++k) d[k] = h->p2[k] - h->p1[k];
    for (int i = 0; i < STEPS; ++i) {
        double t = (i + 0.5) / STEPS, x = h->p1[0] + t * d[0], y = h->p1[1] + t * d[1];
        sum += sqrt((x * x + y * y) * d[2] * d[2] + pow(x * d[0] + y * d[1], 2));
    }
    return h->phi_max * pi / 180 * sum / STEPS;
}

static void a_hyperboloid_has_its_area_and_normals(void **state)
{
    (void)state;
    static const hyperboloid_t cases[] = {
        {{1, -1, -1}, {1, 1, 1}, 360},     /* one sheet */
        {{0, 0, 0}, {1, 1, 1}, 360},       /* pbrt's default, a cone */
        {{-1, 0, 0}, {1, 0, 2}, 360},      /* a double cone */
        {{0.5, 2, 0.1}, {1, -0.3, 3}, 90}, /* a part */
        {{1, 1, 2}, {0.2, 1, 0}, 200},     /* the ends change places */
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        const hyperboloid_t *h = &cases[i];
        mesh_t mesh = {0};
        ACCEPTED(tessellate_hyperboloid(h, here, &mesh));
        check_mesh(&mesh, 1, true);
        expect_near(area_of(&mesh), hyperboloid_area(h), 4e-4 * hyperboloid_area(h));
        const double *p1 = h->p2[2] == 0 ? h->p2 : h->p1, *p2 = h->p2[2] == 0 ? h->p1 : h->p2;
        for (uint32_t k = 0; k < mesh.vertex_count; ++k) {
            double phi = (double)mesh.uvs[k].x * h->phi_max * pi / 180, v = (double)mesh.uvs[k].y;
            double x = (1 - v) * p1[0] + v * p2[0], y = (1 - v) * p1[1] + v * p2[1];
            double dx = p2[0] - p1[0], dy = p2[1] - p1[1], c = cos(phi), s = sin(phi);
            vec3_t p = mesh.positions[k];
            expect_near((double)p.x, x * c - y * s, 1e-6);
            expect_near((double)p.y, x * s + y * c, 1e-6);
            vec3_t du = vec3(-p.y, p.x, 0);
            vec3_t dv = vec3((float)(dx * c - dy * s), (float)(dx * s + dy * c), (float)(p2[2] - p1[2]));
            if (v_length(du) > 1e-3f)
                expect_near((double)v_dot(mesh.normals[k], v_normalize(v_cross(du, dv))), 1, 1e-5);
        }
        mesh_free(&mesh);
    }
    REFUSED(tessellate_hyperboloid(&(hyperboloid_t){{0, 0, 1}, {1, 0, 1}, 360}, here, &refused),
            "both lie at z");
    REFUSED(tessellate_hyperboloid(&(hyperboloid_t){{0, 0, 1}, {0, 0, 2}, 360}, here, &refused),
            "on its axis");
}

/* ---- subdivision --------------------------------------------------------------------------------------- */

static const double octahedron_points[] = {1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
static const double octahedron_faces[] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4,
                                          2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};

static void an_octahedron_is_subdivided_towards_its_limit(void **state)
{
    (void)state;
    for (int levels = 0; levels < 6; ++levels) {
        loop_t loop = {octahedron_points, 6, octahedron_faces, 24, levels};
        mesh_t mesh = {0};
        ACCEPTED(tessellate_loop(&loop, here, &mesh));
        uint32_t faces = 8u << (2 * levels);
        assert_int_equal(mesh.triangle_count, faces);
        assert_int_equal(mesh.vertex_count, 2 + faces / 2); /* Euler: V - 3F/2 + F = 2 */
        /* The limit of a corner: (1 - 4 g) (1, 0, 0), the four about it cancel; beta(4) = 3/32, g = 1/8. */
        expect_vec3(mesh.positions[0], 0.5, 0, 0);
        /* pbrt's normals of a mesh that turns counterclockwise point inward */
        expect_vec3(mesh.normals[0], -1, 0, 0);
        if (levels >= 3) check_mesh(&mesh, -1, false);
        mesh_free(&mesh);
    }
}

static void a_subdivided_plane_stays_plane(void **state)
{
    (void)state;
    enum { SIDE = 4 };
    double points[3 * SIDE * SIDE], faces[6 * (SIDE - 1) * (SIDE - 1)];
    size_t count = 0;
    for (int i = 0; i < SIDE * SIDE; ++i) {
        points[3 * i] = i % SIDE;
        points[3 * i + 1] = i / SIDE;
        points[3 * i + 2] = 7;
    }
    for (int y = 0; y + 1 < SIDE; ++y)
        for (int x = 0; x + 1 < SIDE; ++x) {
            int v = y * SIDE + x, quad[6] = {v, v + 1, v + 1 + SIDE, v, v + 1 + SIDE, v + SIDE};
            for (int k = 0; k < 6; ++k) faces[count++] = quad[k];
        }
    loop_t loop = {points, SIDE * SIDE, faces, count, 3};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_loop(&loop, here, &mesh));
    check_mesh(&mesh, -1, false);
    uint32_t side = 8 * (SIDE - 1) + 1;
    assert_int_equal(mesh.vertex_count, side * side);
    for (uint32_t i = 0; i < mesh.vertex_count; ++i) {
        expect_near((double)mesh.positions[i].z, 7, 1e-6);
        expect_vec3(mesh.normals[i], 0, 0, -1);
    }
    expect_vec3(mesh.positions[5], 1, 1, 7); /* of valence 6 in a regular grid: it stays */
    mesh_free(&mesh);

    /* Along a boundary the limit is the uniform cubic B-spline: (1, 4, 1) / 6 of the control points. */
    loop.levels = 6;
    points[3 * 1 + 2] = 13;
    ACCEPTED(tessellate_loop(&loop, here, &mesh));
    expect_near((double)mesh.positions[1].z, 7 + 6 * 4.0 / 6, 1e-3);
    mesh_free(&mesh);
}

static void meshes_that_cannot_be_subdivided_are_refused(void **state)
{
    (void)state;
    static const double points[18] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1, 2, 2, 1};
    static const double fin[] = {0, 1, 2, 1, 0, 3, 0, 1, 4}, opposite[] = {0, 1, 2, 0, 1, 3};
    static const double bow_tie[] = {0, 1, 2, 0, 3, 4}, twice[] = {0, 1, 1}, far[] = {0, 1, 6},
                        half[] = {0, 1, 0.5};
    REFUSED(tessellate_loop(&(loop_t){points, 6, fin, 9, 1}, here, &refused),
            "triangles 0, 1 and 2 share an edge");
    REFUSED(tessellate_loop(&(loop_t){points, 6, opposite, 6, 1}, here, &refused),
            "triangles 0 and 1 turn opposite");
    REFUSED(tessellate_loop(&(loop_t){points, 6, bow_tie, 6, 1}, here, &refused),
            "only one vertex joins parts");
    REFUSED(tessellate_loop(&(loop_t){points, 6, twice, 3, 1}, here, &refused), "uses vertex 1 twice");
    REFUSED(tessellate_loop(&(loop_t){points, 6, far, 3, 1}, here, &refused), "index number 2 is 6");
    REFUSED(tessellate_loop(&(loop_t){points, 6, half, 3, 1}, here, &refused), "index number 2 is 0.5");
    REFUSED(tessellate_loop(&(loop_t){points, 6, far, 2, 1}, here, &refused), "three a triangle");
    REFUSED(tessellate_loop(&(loop_t){points, 6, far, 3, 11}, here, &refused), "11 levels");
    REFUSED(tessellate_loop(&(loop_t){points, 6, far, 3, -1}, here, &refused), "-1 levels");
    static double triangle[3 * 16];
    REFUSED(tessellate_loop(&(loop_t){points, 6, triangle, 48, 10}, here, &refused), "take fewer levels");
    double *many = mem_zalloc(3 * 256, sizeof *many);
    REFUSED(tessellate_loop(&(loop_t){points, 6, many, 3 * 256, 10}, here, &refused), "over the limit");
    free(many);

    /* a vertex that nothing uses is left out; two triangles back to back are a sphere */
    static const double pillow[] = {5, 1, 2, 2, 1, 5};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_loop(&(loop_t){points, 6, pillow, 6, 2}, here, &mesh));
    assert_int_equal(mesh.triangle_count, 32);
    assert_int_equal(mesh.vertex_count, 18);
    mesh_free(&mesh);
}

/* ---- grids --------------------------------------------------------------------------------------------- */

static void a_height_field_has_its_heights_and_normals(void **state)
{
    (void)state;
    static const double heights[6] = {0, 1, 2, 10, 11, 12};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_heightfield(&(heightfield_t){3, 2, heights, 6}, here, &mesh));
    check_mesh(&mesh, 1, true);
    assert_null(mesh.normals);
    expect_vec3(mesh.positions[4], 0.5, 1, 11);
    static const blob_triangle_t triangles[4] = {{{0, 1, 4}}, {{0, 4, 3}}, {{1, 2, 5}}, {{1, 5, 4}}};
    assert_int_equal(mesh.triangle_count, 4);
    assert_memory_equal(mesh.triangles, triangles, sizeof triangles);
    mesh_free(&mesh);
    REFUSED(tessellate_heightfield(&(heightfield_t){3, 3, heights, 6}, here, &refused), "6 heights");
    REFUSED(tessellate_heightfield(&(heightfield_t){1, 6, heights, 6}, here, &refused), "at least 2");
    REFUSED(tessellate_heightfield(&(heightfield_t){1e9, 1e9, heights, 6}, here, &refused), "over the limit");
    REFUSED(tessellate_heightfield(&(heightfield_t){NAN, 2, heights, 6}, here, &refused), "at least 2");
}

static void a_bilinear_patch_has_its_area_and_normals(void **state)
{
    (void)state;
    /* a parallelogram, and the saddle z = x y beside it */
    static const double points[] = {0, 0, 0, 2, 0, 0, 1, 1, 0, 3, 1, 0, 5, 0, 0, 6, 0, 0, 5, 1, 0, 6, 1, 1};
    static const double indices[] = {0, 1, 2, 3, 4, 5, 6, 7};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_bilinear(
        &(bilinear_t){.positions = points, .vertex_count = 8, .indices = indices, .index_count = 4}, here,
        &mesh));
    check_mesh(&mesh, 1, true);
    assert_int_equal(mesh.triangle_count, 2);
    assert_null(mesh.normals);
    expect_vec3(triangle_cross(&mesh, 0), 0, 0, 2);
    mesh_free(&mesh);

    ACCEPTED(tessellate_bilinear(
        &(bilinear_t){.positions = points, .vertex_count = 8, .indices = indices, .index_count = 8}, here,
        &mesh));
    check_mesh(&mesh, 1, true);
    expect_near(area_of(&mesh), 2 + 1.2807892, 2e-4); /* the double integral of sqrt(1 + x^2 + y^2) */
    for (uint32_t i = 4; i < mesh.vertex_count; ++i) {
        vec3_t p = mesh.positions[i];
        float x = p.x - 5;
        expect_near((double)p.z, (double)(x * p.y), 1e-6);
        expect_near((double)mesh.uvs[i].x, (double)x, 1e-6);
        expect_near((double)v_dot(mesh.normals[i], v_normalize(vec3(-p.y, -x, 1))), 1, 1e-6);
    }
    mesh_free(&mesh);

    /* a triangle with its first edge collapsed: no degenerate triangle, a normal at the pole */
    static const double fan[] = {0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 1, 0};
    static const double normals[] = {0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 0}, uvs[] = {0, 0, 1, 0, 0, 3, 1, 3};
    ACCEPTED(tessellate_bilinear(&(bilinear_t){.positions = fan, .vertex_count = 4}, here, &mesh));
    check_mesh(&mesh, 1, true);
    expect_near(area_of(&mesh), 0.5, 1e-6);
    mesh_free(&mesh);
    ACCEPTED(tessellate_bilinear(&(bilinear_t){fan, 4, normals, 4, uvs, 4, NULL, 0}, here, &mesh));
    uint32_t last = mesh.vertex_count - 1;
    expect_vec3(mesh.normals[last], 0, 1, 0);
    expect_near((double)mesh.uvs[last].y, 3, 0);
    mesh_free(&mesh);

    bilinear_t bad = {.positions = points, .vertex_count = 8, .indices = indices, .index_count = 7};
    REFUSED(tessellate_bilinear(&bad, here, &refused), "7 indices");
    bad.indices = NULL;
    REFUSED(tessellate_bilinear(&bad, here, &refused), "8 vertices and 0 indices");
    bad = (bilinear_t){points, 7, NULL, 0, NULL, 0, indices, 8};
    REFUSED(tessellate_bilinear(&bad, here, &refused), "index number 7 is 7");
    bad = (bilinear_t){points, 8, points, 7, NULL, 0, indices, 8};
    REFUSED(tessellate_bilinear(&bad, here, &refused), "7 normals for 8");
    bad = (bilinear_t){points, 8, NULL, 0, points, 9, indices, 8};
    REFUSED(tessellate_bilinear(&bad, here, &refused), "9 uv coordinates for 8");
}

/* ---- NURBS --------------------------------------------------------------------------------------------- */

/* A quarter of a cylinder about z: a rational quadratic in u, linear in v. */
static void a_rational_patch_is_a_true_cylinder(void **state)
{
    (void)state;
    static const double uknots[] = {0, 0, 0, 2, 2, 2}, vknots[] = {0, 0, 1, 1};
    double w = sqrt(0.5);
    double points[] = {1, 0, 0, 1, w, w, 0, w, 0, 1, 0, 1, 1, 0, 3, 1, w, w, 3 * w, w, 0, 1, 3, 1};
    nurbs_t nurbs = {.u = {.order = 3, .count = 3, .knots = uknots, .knot_count = 6},
                     .v = {.order = 2, .count = 2, .knots = vknots, .knot_count = 4},
                     .points = points,
                     .number_count = 24,
                     .rational = true};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_nurbs(&nurbs, here, &mesh));
    check_mesh(&mesh, 1, false);
    assert_int_equal(mesh.vertex_count, 900);
    assert_int_equal(mesh.triangle_count, 2 * 29 * 29);
    expect_near(area_of(&mesh), pi / 2 * 3, 2e-3);
    expect_near((double)mesh.uvs[29].x, 2, 0); /* uv are the parameters */
    for (uint32_t i = 0; i < mesh.vertex_count; ++i) {
        vec3_t p = mesh.positions[i];
        expect_near(hypot((double)p.x, (double)p.y), 1, 1e-6);
        expect_near((double)p.z, 3 * (double)mesh.uvs[i].y, 1e-6);
        expect_vec3(mesh.normals[i], (double)p.x, (double)p.y, 0);
    }
    mesh_free(&mesh);

    nurbs.u.has_range = true;
    nurbs.u.range[0] = 0.5;
    nurbs.u.range[1] = 2.5;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "u0 0.5 and u1 2.5");
    nurbs.u.range[1] = 0.5;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "must differ");
    nurbs.u.has_range = false;
    nurbs.number_count = 23;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "23 numbers in \"Pw\" for 3 by 2");
    nurbs.number_count = 24;
    nurbs.u.order = 1;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "uorder is 1");
    nurbs.u.order = 4;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "nu is 3");
    nurbs.u.order = 3;
    nurbs.v.knot_count = 5;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "5 numbers in vknots");
    nurbs.v.knot_count = 4;
    nurbs.v.knots = (const double[]){0, 1, 0, 1};
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "number 2 of vknots is 0");
    nurbs.v.knots = (const double[]){0, 1, 1, 2};
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "vknots leave no range");
    nurbs.v.knots = vknots;
    for (int i = 0; i < 6; ++i) points[4 * i + 3] = 0;
    REFUSED(tessellate_nurbs(&nurbs, here, &refused), "weight vanishes");
}

/* Uniform knots with inner ones, not clamped, and a double knot: the polynomial case against a graph z = x^2
 * whose control points are its polar form. */
static void inner_knots_follow_the_polar_form(void **state)
{
    (void)state;
    static const double knots[] = {-2, -1, 0, 1, 1, 2, 3, 4}, line[] = {0, 0, 1, 1};
    double points[2 * 5 * 3];
    for (int v = 0; v < 2; ++v)
        for (int i = 0; i < 5; ++i) {
            double a = knots[i + 1], b = knots[i + 2], *p = points + 3 * (5 * v + i);
            p[0] = 0.5 * (a + b);
            p[1] = v;
            p[2] = a * b;
        }
    nurbs_t nurbs = {.u = {.order = 3, .count = 5, .knots = knots, .knot_count = 8},
                     .v = {.order = 2, .count = 2, .knots = line, .knot_count = 4},
                     .points = points,
                     .number_count = 30};
    mesh_t mesh = {0};
    ACCEPTED(tessellate_nurbs(&nurbs, here, &mesh));
    check_mesh(&mesh, 1, false);
    for (uint32_t i = 0; i < mesh.vertex_count; ++i) {
        vec3_t p = mesh.positions[i];
        expect_near((double)p.x, (double)mesh.uvs[i].x, 1e-6);
        expect_near((double)p.z, (double)(p.x * p.x), 1e-6);
        expect_near((double)v_dot(mesh.normals[i], v_normalize(vec3(-2 * p.x, 0, 1))), 1, 1e-6);
    }
    expect_near((double)mesh.uvs[0].x, 0, 0);
    expect_near((double)mesh.uvs[29].x, 2, 0);
    mesh_free(&mesh);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_cone_has_its_area_and_normals),
        cmocka_unit_test(a_paraboloid_has_its_area_and_normals),
        cmocka_unit_test(a_hyperboloid_has_its_area_and_normals),
        cmocka_unit_test(an_octahedron_is_subdivided_towards_its_limit),
        cmocka_unit_test(a_subdivided_plane_stays_plane),
        cmocka_unit_test(meshes_that_cannot_be_subdivided_are_refused),
        cmocka_unit_test(a_height_field_has_its_heights_and_normals),
        cmocka_unit_test(a_bilinear_patch_has_its_area_and_normals),
        cmocka_unit_test(a_rational_patch_is_a_true_cylinder),
        cmocka_unit_test(inner_knots_follow_the_polar_form),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
