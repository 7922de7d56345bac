/* film: see film.h. Polarisation and absorption are left out, Fresnel's equations are Schlick's approximation
 * at both interfaces, and an interface shifts the phase by nothing or by half a wave. */
#include "worker/render/bsdf/film.h"

#include "worker/render/bsdf/fresnel.h"

/* Of an interface between two indices, at normal incidence. */
static float normal_reflectance(float far, float near)
{
    float ratio = (far - near) / (far + near);
    return ratio * ratio;
}

static float schlick(float f0, float cos)
{
    return f0 + (1 - f0) * fresnel_schlick_weight(cos);
}

/* The index of refraction of what reflects f0 in air; a little is added, since that of 1 is infinite. */
static float index_of(float f0)
{
    float root = sqrtf(float_clamp(f0 + 1e-4f, 0, 0.9999f));
    return (1 + root) / (1 - root);
}

/* A Gaussian about the wave number `position`, as the Fourier transform of it sees a path difference. */
static float wave(float height, float position, float variance, float phase, float shift)
{
    return height * sqrtf(TWO_PI_F * variance) * cosf(position * phase + shift) *
           expf(-variance * phase * phase);
}

/* The eye's matching functions, as a sum of Gaussians over the wave number, at the path difference
 * `difference` (in nanometres), with a shift of the phase of each of the colours; in linear sRGB (Belcour and
 * Barla 2017, section 4). */
static rgb_t sensitivity(float difference, rgb_t shift)
{
    float phase = TWO_PI_F * difference * 1e-9f;
    float x = wave(5.4856e-13f, 1.6810e6f, 4.3278e9f, phase, shift.x) +
              wave(9.7470e-14f, 2.2399e6f, 4.5282e9f, phase, shift.x);
    float y = wave(4.4201e-13f, 1.7953e6f, 9.3046e9f, phase, shift.y);
    float z = wave(5.2481e-13f, 2.2084e6f, 6.6121e9f, phase, shift.z);
    rgb_t rgb = vec3(3.2404542f * x - 1.5371385f * y - 0.4985314f * z,
                     -0.9692660f * x + 1.8760108f * y + 0.0415560f * z,
                     0.0556434f * x - 0.2040259f * y + 1.0572252f * z);
    return v_scale(rgb, 1 / 1.0685e-7f);
}

/* The two interfaces in one channel: what is reflected on the whole, the reflectance of both, and the shift
 * of the phase between them. */
typedef struct {
    float constant, both, shift, amplitude;
} channel_film_t;

static channel_film_t between_interfaces(const lobe_film_t *film, float f0, float upper, float cos)
{
    float base = index_of(f0), lower = schlick(normal_reflectance(base, film->ior), cos);
    float both = float_clamp(upper * lower, 1e-5f, 0.9999f), passed = 1 - upper;
    float scattered = passed * passed * lower / (1 - both);
    return (channel_film_t){.constant = upper + scattered,
                            .both = both,
                            .shift = PI_F + (base < film->ior ? PI_F : 0),
                            .amplitude = scattered - passed};
}

/* What all orders of interference add at one wavelength: the sum of root^m cos(m phase). */
static float interference(const channel_film_t *r, float difference, uint16_t wave)
{
    float root = sqrtf(r->both), phase = TWO_PI_F * difference * FILM_PART / (float)wave + r->shift;
    float c = root * cosf(phase);
    return 2 * r->amplitude * (c - r->both) / (1 - 2 * c + r->both);
}

rgb_t film_reflectance(const lobe_film_t *film, rgb_t f0, float cos)
{
    float sin2 = (1 - cos * cos) / (film->ior * film->ior);
    if (sin2 >= 1) return vec3(1, 1, 1);
    float inside = sqrtf(1 - sin2), upper = schlick(normal_reflectance(film->ior, 1), cos);
    channel_film_t r = between_interfaces(film, f0.x, upper, inside),
                   g = between_interfaces(film, f0.y, upper, inside),
                   b = between_interfaces(film, f0.z, upper, inside);
    rgb_t sum = vec3(r.constant, g.constant, b.constant),
          root = vec3(sqrtf(r.both), sqrtf(g.both), sqrtf(b.both)),
          amplitude = vec3(r.amplitude, g.amplitude, b.amplitude), shift = vec3(r.shift, g.shift, b.shift);
    float difference = 2 * film->ior * film->thickness * inside;
    if (film->waves[0] != 0) {
        sum = v_add(sum, vec3(interference(&r, difference, film->waves[0]),
                              interference(&g, difference, film->waves[1]),
                              interference(&b, difference, film->waves[2])));
        return vec3(float_clamp(sum.x, 0, 1), float_clamp(sum.y, 0, 1), float_clamp(sum.z, 0, 1));
    }
    for (int order = 1; order <= 2; order++) {
        amplitude = v_mul(amplitude, root);
        rgb_t waves = sensitivity((float)order * difference, v_scale(shift, (float)order));
        sum = v_mad(sum, 2, v_mul(amplitude, waves));
    }
    return vec3(float_clamp(sum.x, 0, 1), float_clamp(sum.y, 0, 1), float_clamp(sum.z, 0, 1));
}
