/* revolve: cones, paraboloids and hyperboloids.
 *
 * A shape lays down rows: for some parameters v its point at phi = 0, and the direction of dp/du x dp/dv
 * there. Both turn with phi, so that revolve makes the mesh out of rows alone. A row on the axis is a pole:
 * it gets one vertex for each column, halfway in phi, which has a normal and a uv of its own, since neither
 * is unique there. Two poles in a row end one nappe and begin the next.
 *
 * The rows are rulings' ends or evenly spaced in the radius; with 256 columns the chord stays within 7.6e-5
 * radii of the circle.
 */
#include "client/import/tessellate/grid.h"
#include "client/import/tessellate/tessellate.h"

enum { CONE_ROWS = 16, MAX_ROWS = 2 * (TESSELLATE_ROWS + 1) };

typedef struct {
    dvec3_t p, normal; /* at phi = 0; the normal of any length */
    double v;
    bool pole;
} row_t;

typedef struct {
    row_t rows[MAX_ROWS];
    uint32_t count;
    double phi_max; /* degrees, over 0, at most 360 */
} rows_t;

static bool is_positive(double x)
{
    return x > 0 && isfinite(x);
}

static result_t take_phi(double phi_max, position_t at, rows_t *rows)
{
    if (!is_positive(phi_max)) return error_at(at, "phimax is %g, but must be positive", phi_max);
    rows->phi_max = fmin(phi_max, 360);
    return result_ok();
}

/* ---- from rows to a mesh ------------------------------------------------------------------------------ */

/* Cosine and sine of phi at `position` columns; exactly those of 0 where a full circle closes. */
static void turn_at(const rows_t *rows, double position, double *cosine, double *sine)
{
    if (rows->phi_max == 360 && position == TESSELLATE_COLUMNS) position = 0;
    double phi = position / TESSELLATE_COLUMNS * rows->phi_max * (3.14159265358979323846 / 180);
    *cosine = cos(phi);
    *sine = sin(phi);
}

static dvec3_t turned(dvec3_t a, double cosine, double sine)
{
    return (dvec3_t){a.x * cosine - a.y * sine, a.x * sine + a.y * cosine, a.z};
}

static void add_row(mesh_t *mesh, const rows_t *rows, const row_t *row)
{
    uint32_t vertices = TESSELLATE_COLUMNS + !row->pole;
    for (uint32_t i = 0; i < vertices; ++i) {
        double position = i + (row->pole ? 0.5 : 0), cosine, sine;
        turn_at(rows, position, &cosine, &sine);
        uint32_t vertex = mesh->vertex_count++;
        mesh->positions[vertex] = d_to_float(turned(row->p, cosine, sine));
        mesh->normals[vertex] = d_direction(turned(row->normal, cosine, sine));
        mesh->uvs[vertex] = (vec2_t){(float)(position / TESSELLATE_COLUMNS), (float)row->v};
    }
}

/* The triangles between two rows whose vertices begin at `a` and `b`. */
static void add_band(mesh_t *mesh, uint32_t a, bool a_pole, uint32_t b, bool b_pole)
{
    for (uint32_t i = 0; i < TESSELLATE_COLUMNS; ++i) {
        if (!a_pole) mesh_triangle(mesh, a + i, a + i + 1, b_pole ? b + i : b + i + 1);
        if (!b_pole) mesh_triangle(mesh, a + i, b + i + 1, b + i);
    }
}

static void revolve(const rows_t *rows, mesh_t *mesh)
{
    size_t most = (size_t)rows->count * (TESSELLATE_COLUMNS + 1);
    mesh_reserve(mesh, most, 2 * most, true, true);
    uint32_t before = 0;
    for (uint32_t i = 0; i < rows->count; ++i) {
        uint32_t first = mesh->vertex_count;
        add_row(mesh, rows, &rows->rows[i]);
        bool nappes_meet = i > 0 && rows->rows[i - 1].pole && rows->rows[i].pole;
        if (i > 0 && !nappes_meet) add_band(mesh, before, rows->rows[i - 1].pole, first, rows->rows[i].pole);
        before = first;
    }
}

/* ---- the shapes --------------------------------------------------------------------------------------- */

/* p(v) = (radius (1 - v), 0, height v): dp/du x dp/dv is along (height, 0, radius). */
result_t tessellate_cone(const cone_t *cone, position_t at, mesh_t *mesh)
{
    rows_t rows = {.count = CONE_ROWS + 1};
    TRY(take_phi(cone->phi_max, at, &rows));
    if (!is_positive(cone->radius))
        return error_at(at, "the cone's radius is %g, but must be positive", cone->radius);
    if (!is_positive(cone->height))
        return error_at(at, "the cone's height is %g, but must be positive", cone->height);
    for (uint32_t i = 0; i < rows.count; ++i) {
        double v = (double)i / CONE_ROWS;
        rows.rows[i] = (row_t){.p = {cone->radius * (1 - v), 0, cone->height * v},
                               .normal = {cone->height, 0, cone->radius},
                               .v = v,
                               .pole = i == CONE_ROWS};
    }
    revolve(&rows, mesh);
    return result_ok();
}

/* dp/du is along y and dp/dv along (r / 2z, 0, 1), so that the normal is along (r, 0, -r^2 / 2z), where r^2 /
 * z is radius^2 / z_max everywhere. */
result_t tessellate_paraboloid(const paraboloid_t *paraboloid, position_t at, mesh_t *mesh)
{
    rows_t rows = {.count = TESSELLATE_ROWS + 1};
    TRY(take_phi(paraboloid->phi_max, at, &rows));
    double radius = paraboloid->radius, low = fmin(paraboloid->z_min, paraboloid->z_max),
           high = fmax(paraboloid->z_min, paraboloid->z_max);
    if (!is_positive(radius))
        return error_at(at, "the paraboloid's radius is %g, but must be positive", radius);
    if (!isfinite(low) || !isfinite(high) || !(low < high) || high == 0)
        return error_at(at, "a paraboloid from zmin %g to zmax %g: they must differ, and zmax must not be 0",
                        low, high);
    double begin = high > 0 ? fmax(low, 0) : low; /* there is nothing on the other side of the apex */
    double r0 = radius * sqrt(begin / high), r1 = radius;
    if (!isfinite(r0)) return error_at(at, "the paraboloid's radius at zmin %g is not finite", low);
    for (uint32_t i = 0; i < rows.count; ++i) {
        double t = (double)i / TESSELLATE_ROWS, r = (1 - t) * r0 + t * r1;
        double z = i == 0 ? begin : i == TESSELLATE_ROWS ? high : high * (r / radius) * (r / radius);
        rows.rows[i] = (row_t){.p = {r, 0, z},
                               .normal = {r, 0, -0.5 * radius * (radius / high)},
                               .v = (z - low) / (high - low),
                               .pole = r == 0};
    }
    revolve(&rows, mesh);
    return result_ok();
}

/* The rows of p1 + v (p2 - p1) for v from v0 to v1, on one side of the axis; an end named a pole is put onto
 * the axis. There the direction of dp/du, which turns by half a circle at the axis, is that of the piece's
 * middle. */
static void add_rulings(rows_t *rows, dvec3_t p1, dvec3_t p2, double v0, double v1, const bool poles[2])
{
    dvec3_t along = d_sub(p2, p1), middle = d_lerp(0.5 * (v0 + v1), p1, p2);
    for (uint32_t i = 0; i <= TESSELLATE_ROWS; ++i) {
        double t = (double)i / TESSELLATE_ROWS, v = (1 - t) * v0 + t * v1;
        bool pole = (i == 0 && poles[0]) || (i == TESSELLATE_ROWS && poles[1]);
        dvec3_t p = d_lerp(v, p1, p2), arm = pole ? middle : p;
        if (pole) p.x = p.y = 0;
        rows->rows[rows->count++] =
            (row_t){.p = p, .normal = d_cross((dvec3_t){-arm.y, arm.x, 0}, along), .v = v, .pole = pole};
    }
}

result_t tessellate_hyperboloid(const hyperboloid_t *hyperboloid, position_t at, mesh_t *mesh)
{
    rows_t rows = {0};
    TRY(take_phi(hyperboloid->phi_max, at, &rows));
    bool swapped = hyperboloid->p2[2] == 0;
    dvec3_t p1 = d_vec3(swapped ? hyperboloid->p2 : hyperboloid->p1);
    dvec3_t p2 = d_vec3(swapped ? hyperboloid->p1 : hyperboloid->p2);
    dvec3_t along = d_sub(p2, p1);
    double largest = fmax(hypot(p1.x, p1.y), hypot(p2.x, p2.y));
    if (!isfinite(d_length(along)) || !isfinite(largest))
        return error_at(at, "the hyperboloid's p1 and p2 must be finite");
    if (along.z == 0) return error_at(at, "the hyperboloid's p1 and p2 both lie at z = %g; use a disk", p1.z);
    if (largest == 0) return error_at(at, "the hyperboloid's p1 and p2 both lie on its axis");

    double run2 = along.x * along.x + along.y * along.y;
    double nearest = run2 > 0 ? fmin(fmax(-(p1.x * along.x + p1.y * along.y) / run2, 0), 1) : 0;
    dvec3_t waist = d_lerp(nearest, p1, p2);
    bool meets = hypot(waist.x, waist.y) <= 1e-9 * largest;
    if (!meets || nearest == 0 || nearest == 1) {
        const bool poles[2] = {meets && nearest == 0, meets && nearest == 1};
        add_rulings(&rows, p1, p2, 0, 1, poles);
    } else {
        add_rulings(&rows, p1, p2, 0, nearest, (const bool[2]){false, true});
        add_rulings(&rows, p1, p2, nearest, 1, (const bool[2]){true, false});
    }
    revolve(&rows, mesh);
    return result_ok();
}
