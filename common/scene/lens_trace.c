/* lens_trace: see lens_trace.h. In double precision: radii may be a million times the film's size. */
#include "common/scene/lens_trace.h"

static lens_vec_t along(lens_vec_t a, double s, lens_vec_t b)
{
    return (lens_vec_t){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}

static double dot(lens_vec_t a, lens_vec_t b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static lens_vec_t normalized(lens_vec_t a)
{
    double scale = 1 / sqrt(dot(a, a));
    return (lens_vec_t){scale * a.x, scale * a.y, scale * a.z};
}

double lens_rear(const lens_t *lens)
{
    return (double)lens->elements[lens->count - 1].thickness;
}

double lens_front(const lens_t *lens)
{
    double z = 0;
    for (uint32_t i = 0; i < lens->count; i++) z += (double)lens->elements[i].thickness;
    return z;
}

/* Moves the ray to the surface, whose vertex is at z: of the sphere's two points that on the vertex's side.
 * *normal receives the unit normal against the ray. */
static bool reach_sphere(double radius, double z, lens_ray_t *ray, lens_vec_t *normal)
{
    lens_vec_t o = ray->origin, d = ray->direction;
    o.z -= z - radius; /* the centre lies at the origin */
    double a = dot(d, d), b = dot(o, d), c = dot(o, o) - radius * radius, root = b * b - a * c;
    if (!(root >= 0)) return false;
    /* without cancellation, see Press et al., "Numerical Recipes", 5.6 */
    double q = -(b + copysign(sqrt(root), b)), t0 = q / a, t1 = c / q;
    double t = (d.z > 0) == (radius > 0) ? fmax(t0, t1) : fmin(t0, t1);
    if (!(t >= 0)) return false;
    o = along(o, t, d);
    *normal = normalized(o);
    if (dot(*normal, d) > 0) *normal = (lens_vec_t){-normal->x, -normal->y, -normal->z};
    ray->origin = along(ray->origin, t, d);
    return true;
}

static bool reach_plane(double z, lens_ray_t *ray)
{
    double t = (z - ray->origin.z) / ray->direction.z;
    if (!(t >= 0)) return false;
    ray->origin = along(ray->origin, t, ray->direction);
    return true;
}

/* Snell's law; false when all is reflected. `eta`: index before the surface over that behind it. */
static bool refract(lens_vec_t normal, double eta, lens_vec_t *direction)
{
    lens_vec_t d = normalized(*direction);
    double cosine = -dot(normal, d), k = 1 - eta * eta * (1 - cosine * cosine);
    if (!(k >= 0)) return false;
    lens_vec_t bent = {eta * d.x, eta * d.y, eta * d.z};
    *direction = along(bent, eta * cosine - sqrt(k), normal);
    return true;
}

static bool is_stop(const blob_lens_element_t *element)
{
    return element->curvature_radius == 0;
}

/* Moves the ray to an element, whose vertex is at z, and through its round aperture. */
static bool pass_stop(const blob_lens_element_t *element, double z, lens_ray_t *ray)
{
    if (!reach_plane(z, ray)) return false;
    double x = ray->origin.x, y = ray->origin.y, aperture = (double)element->aperture_radius;
    return x * x + y * y <= aperture * aperture;
}

static bool pass_surface(const blob_lens_element_t *element, double z, double eta, lens_ray_t *ray)
{
    lens_vec_t normal;
    if (!reach_sphere((double)element->curvature_radius, z, ray, &normal)) return false;
    double x = ray->origin.x, y = ray->origin.y, aperture = (double)element->aperture_radius;
    return x * x + y * y <= aperture * aperture && refract(normal, eta, &ray->direction);
}

static float aperture_texel(const lens_t *lens, double column, double row)
{
    if (!(column >= 0 && column < lens->aperture_width && row >= 0 && row < lens->aperture_height)) return 0;
    blob_row_t at = blob_image_row(lens->aperture_width, lens->aperture_height, (uint32_t)row);
    return lens->aperture[at.first + (size_t)column * at.step];
}

/* The image of the stop's square, bilinearly; black around it. */
static float aperture_at(const lens_t *lens, double x, double y)
{
    double u = (1 + x) / 2 * lens->aperture_width - 0.5, v = (1 - y) / 2 * lens->aperture_height - 0.5;
    double column = floor(u), row = floor(v);
    float fx = (float)(u - column), fy = (float)(v - row);
    return (1 - fy) *
               ((1 - fx) * aperture_texel(lens, column, row) + fx * aperture_texel(lens, column + 1, row)) +
           fy * ((1 - fx) * aperture_texel(lens, column, row + 1) +
                 fx * aperture_texel(lens, column + 1, row + 1));
}

/* How much of the ray a stop lets through. */
static float stop_share(const lens_t *lens, const blob_lens_element_t *stop, double z, lens_ray_t *ray)
{
    if (lens->aperture == NULL) return pass_stop(stop, z, ray) ? 1 : 0;
    double radius = (double)stop->aperture_radius;
    return reach_plane(z, ray) ? aperture_at(lens, ray->origin.x / radius, ray->origin.y / radius) : 0;
}

/* The index on the scene's side of an element. */
static double index_before(const lens_t *lens, uint32_t i)
{
    return i == 0 ? 1 : (double)lens->elements[i - 1].eta;
}

float lens_trace_from_film(const lens_t *lens, lens_ray_t *ray)
{
    double z = 0;
    float share = 1;
    for (uint32_t i = lens->count; i-- > 0;) {
        const blob_lens_element_t *element = &lens->elements[i];
        z += (double)element->thickness;
        if (is_stop(element))
            share *= stop_share(lens, element, z, ray);
        else if (!pass_surface(element, z, (double)element->eta / index_before(lens, i), ray))
            return 0;
        if (!(share > 0)) return 0;
    }
    return share;
}

bool lens_trace_from_scene(const lens_t *lens, lens_ray_t *ray)
{
    double z = lens_front(lens);
    for (uint32_t i = 0; i < lens->count; i++) {
        const blob_lens_element_t *element = &lens->elements[i];
        double eta = index_before(lens, i) / (double)element->eta;
        if (is_stop(element) ? !pass_stop(element, z, ray) : !pass_surface(element, z, eta, ray))
            return false;
        z -= (double)element->thickness;
    }
    return true;
}
