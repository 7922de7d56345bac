/* lens: see lens.h. */
#include "client/import/scene/lens.h"

/* ---- focus --------------------------------------------------------------------------------------------- */

/* Where a ray that came in parallel to the axis, `height` from it, crosses the axis (focus), and where it has
 * that height (principal). False when it does not cross. */
static bool cardinal_points(const lens_ray_t *out, double height, double *principal, double *focus)
{
    double slope = out->direction.x / out->direction.z;
    *focus = out->origin.z - out->origin.x / slope;
    *principal = out->origin.z + (height - out->origin.x) / slope;
    return isfinite(*focus) && isfinite(*principal);
}

result_t lens_focus(const lens_t *lens, double height, double distance, double *thickness)
{
    const double apart = 1; /* where the rays start; they are parallel to the axis */
    double principal[2], focus[2];
    lens_ray_t in = {{height, 0, lens_front(lens) + apart}, {0, 0, -1}},
               out = {{height, 0, lens_rear(lens) - apart}, {0, 0, 1}};
    if (!lens_trace_from_scene(lens, &in) || !(lens_trace_from_film(lens, &out) > 0))
        return result_fail(RESULT_INPUT, "lets no ray through near its axis; is the aperture too small?");
    if (!cardinal_points(&in, height, &principal[0], &focus[0]) ||
        !cardinal_points(&out, height, &principal[1], &focus[1]))
        return result_fail(RESULT_INPUT, "does not focus light");
    /* With the film at 0: 1 / (distance - principal[1] - d) + 1 / (principal[0] + d) = 1 / length, where d is
     * how far the lens moves towards the scene. */
    double length = principal[0] - focus[0], free = distance - principal[1] + principal[0],
           under_root = free * (free - 4 * length);
    if (!(length > 0)) return result_fail(RESULT_INPUT, "does not focus light, but spreads it");
    if (!(under_root > 0))
        return result_fail(RESULT_INPUT, "cannot focus on %g: the nearest is %g", distance,
                           4 * length + principal[1] - principal[0]);
    /* The root of d that is nearer to the film, without cancellation. */
    *thickness = lens_rear(lens) - principal[0] + 2 * length * free / (free + sqrt(under_root));
    if (*thickness > 0) return result_ok();
    return result_fail(RESULT_INPUT, "focuses on %g only within itself", distance);
}

/* ---- pupils -------------------------------------------------------------------------------------------- */

/* A box on the plane through the rear of the lens. */
typedef struct {
    double x0, x1, y0, y1; /* empty when x0 > x1 */
} box_t;

static const box_t nothing = {INFINITY, -INFINITY, INFINITY, -INFINITY};

static bool is_empty(const box_t *box)
{
    return box->x0 > box->x1;
}

static box_t grown(box_t box, double x, double y)
{
    return (box_t){box.x0 - x, box.x1 + x, box.y0 - y, box.y1 + y};
}

static bool passes(const lens_t *lens, double film, double x, double y)
{
    double z = lens_rear(lens);
    lens_ray_t ray = {{film, 0, 0}, {x - film, y, z}};
    return lens_trace_from_film(lens, &ray) > 0;
}

/* How far from the middle, in the direction (x, y), rays from a place on the film get through. The last of a
 * row of points that does, and then by bisection. */
static double reach_of(const lens_t *lens, double film, double x, double y, double most)
{
    enum { POINTS = 1024, STEPS = 20 };
    int last = -1;
    for (int i = 0; i < POINTS; i++) {
        double at = most * i / POINTS;
        if (passes(lens, film, at * x, at * y)) last = i;
    }
    if (last < 0) return -1;
    double inside = most * last / POINTS, outside = most * (last + 1) / POINTS;
    for (int i = 0; i < STEPS; i++) {
        double middle = (inside + outside) / 2;
        bool open = passes(lens, film, middle * x, middle * y);
        inside = open ? middle : inside;
        outside = open ? outside : middle;
    }
    return inside;
}

/* The three places of a piece of the film that are looked at. */
enum { PLACES = 3 };
static double place_of(double r0, double r1, int i)
{
    return r0 + (r1 - r0) * i / (PLACES - 1);
}

/* The pupil of the middle of the film is round but for a little; found exactly, since pbrt-v3's weights are
 * relative to its box. The margin is pbrt's. */
static box_t middle_pupil(const lens_t *lens, double radius, double r1)
{
    const double margin = 2 * sqrt(18) / 1024 * radius;
    box_t box = nothing;
    for (int i = 0; i < PLACES; i++) {
        double film = place_of(0, r1, i), right = reach_of(lens, film, 1, 0, 1.5 * radius),
               left = reach_of(lens, film, -1, 0, 1.5 * radius),
               up = reach_of(lens, film, 0, 1, 1.5 * radius);
        if (right < 0) continue;
        box = (box_t){fmin(box.x0, -left), fmax(box.x1, right), fmin(box.y0, -up), fmax(box.y1, up)};
    }
    return is_empty(&box) ? box : grown(box, margin, margin);
}

/* The pupil of a piece of the film, looked for on a grid over a box; it has the other half by symmetry. */
static box_t pupil_in(const lens_t *lens, double r0, double r1, const box_t *region)
{
    enum { COLUMNS = 64, ROWS = 32 };
    double dx = (region->x1 - region->x0) / COLUMNS, dy = region->y1 / ROWS;
    box_t box = nothing;
    for (int i = 0; i < PLACES * (COLUMNS + 1) * (ROWS + 1); i++) {
        double x = region->x0 + dx * (i % (COLUMNS + 1)), y = dy * (i / (COLUMNS + 1) % (ROWS + 1));
        bool inside = x >= box.x0 && x <= box.x1 && y <= box.y1;
        if (inside || !passes(lens, place_of(r0, r1, i / (COLUMNS + 1) / (ROWS + 1)), x, y)) continue;
        box = (box_t){fmin(box.x0, x), fmax(box.x1, x), fmin(box.y0, -y), fmax(box.y1, y)};
    }
    return is_empty(&box) ? box : grown(box, dx, dy);
}

/* The pupil of the next piece lies about that of the one before, or anywhere. */
static box_t next_pupil(const lens_t *lens, double radius, double r0, double r1, const box_t *before)
{
    const box_t all = {-1.5 * radius, 1.5 * radius, -1.5 * radius, 1.5 * radius};
    double step = 2 * (r1 - r0);
    box_t region = grown(*before, (before->x1 - before->x0) / 4 + step, (before->y1 - before->y0) / 4 + step);
    box_t box = is_empty(before) ? nothing : pupil_in(lens, r0, r1, &region);
    return is_empty(&box) ? pupil_in(lens, r0, r1, &all) : box;
}

bool lens_find_pupils(const lens_t *lens, double radius, blob_pupil_t pupils[LENS_PUPILS])
{
    double rear = (double)lens->elements[lens->count - 1].aperture_radius, piece = radius / LENS_PUPILS;
    box_t box = middle_pupil(lens, rear, piece);
    bool found = false;
    for (int i = 0; i < LENS_PUPILS; i++) {
        if (i > 0) box = next_pupil(lens, rear, i * piece, (i + 1) * piece, &box);
        found = found || !is_empty(&box);
        pupils[i] = (blob_pupil_t){0};
        if (!is_empty(&box))
            pupils[i] = (blob_pupil_t){(float)box.x0, (float)box.x1, (float)box.y0, (float)box.y1};
    }
    return found;
}
