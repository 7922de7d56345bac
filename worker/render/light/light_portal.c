/* light_portal: see light_portal.h.
 *
 * A direction (x, y, z) in the portal's frame, z > 0, lies at (s, t) = (atan(x / z), atan(y / z)) / pi + 1/2;
 * a unit of area there has pi^2 (1 - x^2) (1 - y^2) / z steradians.
 */
#include "worker/render/light/light_portal.h"

#include <stdlib.h>

/* Cells of the table along a side, and points of a cell along a side at which it is looked at. */
enum { LEAST_SIDE = 64, MOST_SIDE = 2048, MOST_POINTS = 8 };

/* The unit direction at a place, in the portal's frame. */
static vec3_t local_at(vec2_t st)
{
    /* Short of the horizon, where the tangent overflows. */
    const float nearly = 0.4999999f * PI_F;
    float a = float_clamp((st.x - 0.5f) * PI_F, -nearly, nearly);
    float b = float_clamp((st.y - 0.5f) * PI_F, -nearly, nearly);
    return v_normalize(vec3(tanf(a), tanf(b), 1));
}

static vec3_t to_world(const light_portal_t *portal, vec3_t d)
{
    return v_add(v_add(v_scale(portal->x, d.x), v_scale(portal->y, d.y)), v_scale(portal->z, d.z));
}

/* Not of unit length unless v is. */
static vec3_t to_local(const light_portal_t *portal, vec3_t v)
{
    return vec3(v_dot(v, portal->x), v_dot(v, portal->y), v_dot(v, portal->z));
}

/* The place of a direction of any length; false when it does not lie beyond the portal. */
static bool place_of(vec3_t d, vec2_t *st)
{
    if (!(d.z > 0)) return false;
    *st = (vec2_t){atan2f(d.x, d.z) * INV_PI_F + 0.5f, atan2f(d.y, d.z) * INV_PI_F + 0.5f};
    return true;
}

/* Steradians per unit of area of the square at a unit direction. 1 - x^2 is y^2 + z^2. */
static float stretch_at(vec3_t d)
{
    return PI_F * PI_F * (d.y * d.y + d.z * d.z) * (d.x * d.x + d.z * d.z) / d.z;
}

/* ---- the table ----------------------------------------------------------------------------------------- */

/* As fine as the image. */
static uint32_t side_of_table(const light_t *light)
{
    uint32_t width = 0, height = 0;
    if (light->record->image != 0)
        textures_size(scene_textures(light->scene), light->record->image - 1, &width, &height);
    uint32_t side = width > height ? width : height;
    return side < LEAST_SIDE ? LEAST_SIDE : side > MOST_SIDE ? MOST_SIDE : side;
}

/* So many points on either side that none lies further from the next than the image's pixels do. */
static int points_in_cell(const light_t *light, vec2_t middle, uint32_t side)
{
    uint32_t width, height;
    if (light->record->image == 0) return 1;
    textures_size(scene_textures(light->scene), light->record->image - 1, &width, &height);
    double cell = (double)stretch_at(local_at(middle)) / ((double)side * side);
    double pixel = 4 * M_PI / ((double)width * height);
    return (int)fmin(fmax(ceil(2 * sqrt(cell / pixel)), 2), MOST_POINTS);
}

/* Brightness times solid angle in the mean over a cell; the same times the cosine in *crossing. */
static float weigh_cell(const light_portal_t *portal, const light_t *light,
                        rgb_t (*radiance)(const light_t *light, vec3_t w), uint32_t x, uint32_t y,
                        uint32_t side, double *crossing)
{
    vec2_t middle = {((float)x + 0.5f) / (float)side, ((float)y + 0.5f) / (float)side};
    int points = points_in_cell(light, middle, side);
    double sum = 0;
    for (int k = 0; k < points * points; k++) {
        float dx = ((float)(k % points) + 0.5f) / (float)points;
        float dy = ((float)(k / points) + 0.5f) / (float)points;
        vec3_t d = local_at((vec2_t){((float)x + dx) / (float)side, ((float)y + dy) / (float)side});
        float weight = float_max(rgb_luminance(radiance(light, to_world(portal, d))), 0) * stretch_at(d);
        sum += (double)weight / (points * points);
        *crossing += (double)(weight * d.z) / (points * points);
    }
    return (float)sum;
}

/* What is dark at all points of a cell may still shine between them: every cell has a little. */
static void lift(float *weights, size_t count)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++) sum += (double)weights[i];
    for (size_t i = 0; i < count; i++) weights[i] += (float)(1e-3 * sum / (double)count);
}

void light_portal_init(light_portal_t *portal, const light_t *light,
                       rgb_t (*radiance)(const light_t *light, vec3_t w))
{
    const vec3_t *sides = light->record->portal;
    uint32_t side = side_of_table(light);
    size_t count = (size_t)side * side;
    vec3_t across = v_cross(sides[1], sides[2]);
    *portal = (light_portal_t){.corner = sides[0],
                               .side_x = sides[1],
                               .side_y = sides[2],
                               .x = v_normalize(sides[1]),
                               .z = v_normalize(across),
                               .area = v_length(across)};
    portal->y = v_cross(portal->z, portal->x);
    float *weights = mem_alloc(count * sizeof *weights);
    double crossing = 0;
    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++)
            weights[(size_t)y * side + x] = weigh_cell(portal, light, radiance, x, y, side, &crossing);
    lift(weights, count);
    portal->flux = crossing / (double)count;
    portal->table = window_table_new(weights, side, side);
    portal->all.window = (window_t){{0, 0}, {1, 1}};
    portal->all.integral = window_integral(portal->table, &portal->all.window);
    free(weights);
}

void light_portal_free(light_portal_t *portal)
{
    window_table_destroy(&portal->table);
}

/* ---- views --------------------------------------------------------------------------------------------- */

bool light_portal_look(const light_portal_t *portal, vec3_t point, portal_view_t *view)
{
    vec3_t to_corner = v_sub(portal->corner, point);
    vec3_t opposite = v_add(to_corner, v_add(portal->side_x, portal->side_y));
    if (!place_of(to_local(portal, to_corner), &view->window.low) ||
        !place_of(to_local(portal, opposite), &view->window.high))
        return false;
    if (view->window.low.x > view->window.high.x || view->window.low.y > view->window.high.y) return false;
    view->integral = window_integral(portal->table, &view->window);
    return view->integral > 0;
}

/* Per steradian. */
static float density(const light_portal_t *portal, const portal_view_t *view, vec2_t st, vec3_t d)
{
    return (float)((double)window_weight(portal->table, st) / view->integral) / stretch_at(d);
}

vec3_t light_portal_sample(const light_portal_t *portal, const portal_view_t *view, vec2_t u, float *pdf)
{
    *pdf = 0;
    if (!(view->integral > 0)) return portal->z;
    vec2_t st = window_sample(portal->table, &view->window, u);
    vec3_t d = local_at(st);
    *pdf = density(portal, view, st, d);
    return to_world(portal, d);
}

float light_portal_pdf(const light_portal_t *portal, const portal_view_t *view, vec3_t w)
{
    vec2_t st;
    vec3_t d = to_local(portal, w);
    const window_t *seen = &view->window;
    if (!place_of(d, &st) || st.x < seen->low.x || st.x > seen->high.x || st.y < seen->low.y ||
        st.y > seen->high.y)
        return 0;
    return density(portal, view, st, d);
}
