/* bsdf: how a surface scatters light. One interface for eye and light subpaths.
 *
 * wo points to where the path comes from, wi to where it goes; both leave the surface, of unit length, in
 * world space. What differs between the subpaths is only the transport mode, which matters where a BSDF is
 * not symmetric (refraction scales radiance by the squared ratio of indices, Veach 1997, section 5.2), and
 * the shading-normal correction, which the integrators apply (Veach 1997, section 5.3).
 *
 * Densities are per solid angle, except those of specular (Dirac) lobes, which are discrete probabilities.
 * Cosines are those to the shading normal; which side of the surface a direction is on is told by the
 * geometric normal, so that light does not leak through.
 *
 * A BSDF is a sum of lobes, which a material adds (material/material.h). A lobe knows how to evaluate and
 * sample itself; a new one is one file lobe_*.c, which the end of this file declares.
 */
#ifndef LIGHTMILL_BSDF_H
#define LIGHTMILL_BSDF_H

#include "common/scene/blob_format.h"
#include "worker/render/spectral/waves.h"

#include <assert.h>
#include <stddef.h>
#include <stdint.h>

/* What is carried: an eye subpath carries importance and meets RADIANCE; a light subpath the reverse. */
typedef enum { TRANSPORT_RADIANCE, TRANSPORT_IMPORTANCE } transport_t;

typedef struct {
    rgb_t f;       /* value, without cosine, per steradian */
    float pdf;     /* of choosing wi given wo, per steradian */
    float pdf_rev; /* of choosing wo given wi */
} bsdf_value_t;

typedef struct {
    vec3_t wi;
    rgb_t weight;  /* f |cos| / pdf, Dirac lobes likewise */
    float pdf;     /* of wi given wo: per steradian, or a probability when specular */
    float pdf_rev; /* of wo given wi */
    float squeeze; /* what of the weight is radiance that gets denser at an interface, or thinner; else 1 */
    bool specular;
} bsdf_sample_t;

typedef struct lobe_kind lobe_kind_t;
enum { BSDF_LOBES = 10 };

/* What lobes need to know of the point, by their kind; lobe_KIND.c says what each does with it. Indices of
 * refraction are those of the inside (below the surface) over the outside. A `factor` on the value is
 * 1 / the lobe's scale, which is about its albedo. */
typedef struct {
    float strength;  /* share of the surface that it covers; 0: no film */
    float ior;       /* at least 1 */
    float thickness; /* in nanometres */
    /* The wavelengths of the channels in FILM_PART-ths of a nanometre; 0: they are red, green and blue. */
    uint16_t waves[3];
} lobe_film_t;
enum { FILM_PART = 64 };

typedef struct {
    float ior;
    bool separable;   /* shadowing and masking are independent */
    rgb_t r, t;       /* factors on what is reflected and transmitted */
    lobe_film_t film; /* on the outside; of the interfaces that both reflect and transmit */
    float film_f0;    /* reflectance at normal incidence without it */
    float iors[3];    /* of a dispersing one: of each channel, */
    uint32_t only;    /* and 1 + the only channel that is carried, or 0: all */
} lobe_dielectric_t;

typedef struct {
    rgb_t eta, k;
} lobe_conductor_t;

typedef struct {
    float a, b;
} lobe_oren_nayar_t;

typedef struct {
    rgb_t diffuse, glossy, factor;
} lobe_blend_t;

typedef struct {
    float base, flat, retro; /* shares of its parts */
    float roughness;
} lobe_disney_diffuse_t;

typedef struct {
    float ior, metallic;
    rgb_t r0, factor;
} lobe_disney_specular_t;

typedef struct {
    float alpha; /* of Burley's distribution */
} lobe_disney_coat_t;

/* What lies above a lobe of glTF's materials and takes its part of the light first. */
typedef struct {
    float coat;            /* weight of a clear coat ... */
    vec3_t coat_normal;    /* ... and its normal, which may be its own */
    float sheen;           /* largest channel of a sheen's colour ... */
    float sheen_roughness; /* ... and its roughness */
} lobe_cover_t;

/* The lobes of glTF's materials. */
typedef struct {
    lobe_cover_t cover;
    rgb_t f0;  /* reflectance at normal incidence */
    rgb_t f90; /* at grazing incidence */
    union {
        float factor; /* of the lobes that are what reflection leaves */
        rgb_t gain;   /* of those that reflect: the factor where there is a film */
    };
    lobe_film_t film;
} lobe_schlick_t;

typedef struct {
    lobe_cover_t cover; /* a coat alone */
    float roughness;
    float factor;
} lobe_sheen_t;

typedef struct {
    float exponent;
} lobe_phong_t;

typedef struct {
    uint32_t model; /* MATERIAL_WARD, MATERIAL_WARD_DUER or MATERIAL_WARD_BALANCED */
} lobe_ward_t;

typedef struct {
    float g; /* mean cosine between the way of the light before and after */
} lobe_phase_t;

/* A hair, at the place where a ray meets it. */
typedef struct {
    float h, gamma; /* how far from the middle, -1 to 1, and the arc sine of that */
    float ior;
    rgb_t absorption; /* per radius */
    rgb_t factor;
    float narrowness, gap; /* of the mode TRT along the hair: 1 / variance v, and exp(-2 / v) */
    float inv_scale, norm; /* about the hair: 1 / s of the logistic distribution, and the factor that trimming
                              it to (-pi, pi) takes */
    float sine[3], cosine[3]; /* of what scales turn R, TT and TRT by */
} lobe_hair_t;

/* A table of Fourier series; `series` are the table's own. */
typedef struct {
    const blob_fourier_t *table;
    const blob_series_t *series;
    const float *numbers; /* of the blob */
    const waves_t *waves; /* of the channels; NULL: they are red, green and blue */
    rgb_t factor;
} lobe_fourier_t;

/* A measured BRDF. */
typedef struct {
    const blob_measured_t *table;
    const float *numbers; /* of the blob */
    const waves_t *waves; /* as of lobe_fourier_t */
    rgb_t factor;
} lobe_measured_t;

/* From the outside: the interface of a dielectric (the coat, whose alphas are the lobe's), a medium, and an
 * opaque base. From below the surface the same layers are met in the same order. */
typedef struct {
    float ior;
    float thickness; /* in mean free paths of the medium */
    float g;         /* of the medium's phase function */
    float seed;      /* of the walks: differs from point to point */
    rgb_t albedo;    /* of the medium; black: it only absorbs */
    rgb_t factor;
    bool smooth;    /* the coat */
    bool reflects;  /* the lobe has what the coat reflects; else that is a lobe of its own */
    bool has_metal; /* the base is a metal, else Lambertian */
    union {
        struct {
            float base_alpha[2];
            lobe_conductor_t metal;
        };
        struct {
            rgb_t reflectance; /* of a Lambertian base */
            float returns;     /* lobe_coated_lambert: share of the light leaving the base that comes back */
        };
    };
} lobe_layered_t;

/* One lobe at a point. */
typedef struct {
    const lobe_kind_t *kind;
    rgb_t scale;    /* factor on the lobe's value */
    float chance;   /* of being the one that is sampled; those of a BSDF add up to one */
    float alpha[2]; /* of the Trowbridge-Reitz distribution, along s and t: of lobes with microfacets, and the
                       smooth ones that bsdf_regularize makes into such; of Ward's lobe */
    union {
        lobe_layered_t layered;
        lobe_dielectric_t dielectric;
        lobe_conductor_t conductor;
        lobe_oren_nayar_t oren_nayar;
        lobe_blend_t blend;
        lobe_disney_diffuse_t disney_diffuse;
        lobe_disney_specular_t disney_specular;
        lobe_disney_coat_t disney_coat;
        lobe_schlick_t schlick;
        lobe_sheen_t sheen;
        lobe_phong_t phong;
        lobe_ward_t ward;
        lobe_phase_t phase;
        lobe_hair_t hair;
        lobe_fourier_t fourier;
        lobe_measured_t measured;
    };
} lobe_t;
static_assert(sizeof(lobe_t) <= 112, "a BSDF has ten of them, and is made at every vertex");

enum {
    LOBE_REFLECTS = 1,     /* may carry light to the same side of the surface */
    LOBE_TRANSMITS = 2,    /* may carry light through */
    LOBE_SPECULAR = 4,     /* Dirac: cannot be evaluated, only sampled */
    LOBE_DISPERSES = 8,    /* refracts each channel its own way */
    LOBE_MICROFACETS = 16, /* all of it is as narrow as its alphas say */
    LOBE_REFRACTS = 32     /* what it transmits goes on in another medium (lobe_dielectric_t) */
};

/* Directions are in shading coordinates (s, t, ns): z is the cosine to the shading normal. */
struct lobe_kind {
    uint32_t flags;
    /* The value and both densities of the lobe alone, `scale` and `chance` left out; false when the value is
     * zero. Called only for pairs that the flags allow: `reflect` tells that wo and wi are on the same side
     * of the geometric surface, which the signs of z may contradict; densities are then 0. NULL when
     * specular. */
    bool (*eval)(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value);
    /* Draws wi (wo.z is not 0). weight = f |wi.z| / pdf of the lobe alone, `scale` and `chance` left out. */
    bool (*sample)(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *sample);
    /* Roughens a nearly specular lobe (blob_scene_t's regularize); NULL: it never is one. */
    void (*regularize)(lobe_t *lobe);
    /* Of a lobe that is the same from both sides and in both modes, for lobe_eval_mirrored and
     * lobe_sample_mirrored: the value and both densities for wo above the surface, and a direction drawn for
     * it. */
    bool (*eval_above)(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value);
    bool (*draw_above)(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi);
};

/* A BSDF at a point: its lobes with the frame in which they are evaluated. */
typedef struct {
    vec3_t ng, ns, s, t; /* geometric normal; shading frame (s, t, ns) */
    rgb_t attenuation;   /* per unit length, of the inside (the side away from ng); mostly 0 */
    bool specular;       /* only Dirac lobes: cannot be connected to */
    bool absorbs;        /* attenuation is not 0 */
    int count;
    lobe_t lobes[BSDF_LOBES];
} bsdf_t;

/* To be called when all lobes are added, whose chances are shares: makes these add up to one. */
void bsdf_complete(bsdf_t *bsdf);
/* Evaluates the lobes that are not specular. False when the value is zero; *value is then undefined. */
bool bsdf_eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value);
/* The same for directions about whose sides the two normals disagree, of which bsdf_eval is black and no lobe
 * draws one: as if wi were mirrored at the shading plane. False for all others. */
bool bsdf_eval_split(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value);
/* Draws wi in proportion to the density that bsdf_eval returns, or a specular direction. `u` are two uniform
 * numbers for the direction, `choice` one for the lobe. False when there is nothing to follow. */
bool bsdf_sample(const bsdf_t *bsdf, vec3_t wo, vec2_t u, float choice, transport_t mode,
                 bsdf_sample_t *sample);
/* True when some of it, at least, spreads light so widely that light which arrives nearby, from about the
 * same side, is scattered about the same way: what merging photons supposes. */
bool bsdf_is_broad(const bsdf_t *bsdf);
/* Roughens what is nearly specular. */
void bsdf_regularize(bsdf_t *bsdf);
/* Tells what the subpath that is to be scattered carries: where that is one channel alone, a BSDF that
 * disperses goes on with it. Changes what bsdf_sample draws, not what densities it claims, nor any value. */
static inline void bsdf_carry(bsdf_t *bsdf, rgb_t throughput)
{
    if (bsdf->count != 1 || !(bsdf->lobes[0].kind->flags & LOBE_DISPERSES)) return;
    bool r = throughput.x != 0, g = throughput.y != 0, b = throughput.z != 0;
    bsdf->lobes[0].dielectric.only = r + g + b == 1 ? (r ? 1 : g ? 2 : 3) : 0;
}
/* About how much light the surface throws back or lets through, 0 to 1: the sum of the lobes' scales. For
 * the albedo layer. */
rgb_t bsdf_albedo(const bsdf_t *bsdf);

/* A world direction in shading coordinates (s, t, ns), and back. */
static inline vec3_t bsdf_to_local(const bsdf_t *bsdf, vec3_t v)
{
    return vec3(v_dot(v, bsdf->s), v_dot(v, bsdf->t), v_dot(v, bsdf->ns));
}
static inline vec3_t bsdf_to_world(const bsdf_t *bsdf, vec3_t v)
{
    return v_add(v_add(v_scale(bsdf->s, v.x), v_scale(bsdf->t, v.y)), v_scale(bsdf->ns, v.z));
}

/* What light loses per unit length when it leaves the surface in direction w. */
static inline rgb_t bsdf_attenuation(const bsdf_t *bsdf, vec3_t w)
{
    return bsdf->absorbs && v_dot(w, bsdf->ng) < 0 ? bsdf->attenuation : vec3(0, 0, 0);
}

/* The lobes; each file says what it does. lobe_fourier and lobe_measured are in tabulated/, lobe_hair is in
 * material/, and lobe_phase in medium/. */
extern const lobe_kind_t lobe_lambert, lobe_lambert_transmission, lobe_oren_nayar, lobe_mirror,
    lobe_smooth_dielectric, lobe_smooth_conductor, lobe_pane, lobe_straight, lobe_rough_conductor,
    lobe_rough_dielectric, lobe_rough_reflection, lobe_rough_transmission, lobe_fresnel_blend,
    lobe_disney_diffuse, lobe_disney_sheen, lobe_disney_specular, lobe_disney_clearcoat, lobe_layered,
    lobe_coated_lambert, lobe_smooth_coat, lobe_rough_coat, lobe_smooth_layers, lobe_schlick_reflection,
    lobe_schlick_mirror, lobe_schlick_diffuse, lobe_schlick_through, lobe_schlick_straight, lobe_schlick_coat,
    lobe_schlick_coat_mirror, lobe_schlick_diffuse_through, lobe_sheen, lobe_smooth_dispersion,
    lobe_rough_dispersion, lobe_phase, lobe_phong, lobe_ward, lobe_hair, lobe_fourier, lobe_measured;

#endif
