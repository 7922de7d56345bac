/* lobe_sheen: glTF's sheen (KHR_materials_sheen), the velvet of upright fibres: a microfacet reflection
 * without Fresnel's factor, with the distribution "Charlie" of normals and the shadowing that was fitted to
 * it (Conty Estevez and Kulla 2017, "Production Friendly Microfacet Sheen BRDF"). It is the same from both
 * sides, and drawn uniformly over the hemisphere, since it has no peak.
 *
 * What lies below has what the sheen leaves, 1 - c E, with the albedo E at the more grazing direction, whence
 * nothing is gained (lobe_cover_passes). E has no closed form; it is in a table, whose truth
 * tests/statistics/test_gltf_lobes.c knows. */
#include "worker/render/bsdf/lobe.h"

#include "common/base.h"
#include "worker/render/sampling/warp.h"

/* Closer to the surface the fit of the shadowing is no longer one, and its pole may not be met. */
#define LEAST_COSINE 1e-3f
/* A smaller roughness would be a rim that is narrower than the table's columns. */
#define LEAST_ROUGHNESS 0.1f

/* ---- albedo -------------------------------------------------------------------------------------------- */

enum { ROWS = 16, COLUMNS = 24 };

/* Of the fitted formula. Rows: the square root of how far the roughness is from LEAST_ROUGHNESS to 1.
 * Columns: the square root of the cosine from 0 to 1. */
static const float albedos[ROWS][COLUMNS] = {
    {2.1084f, 2.1272f, 1.9979f, 1.7072f, 1.3827f, 1.0742f, 0.8026f, 0.5758f,
     0.3949f, 0.2574f, 0.1581f, 0.0906f, 0.0479f, 0.0230f, 0.0098f, 0.0036f,
     0.0011f, 0.0003f, 0.0001f, 0.0000f, 0.0000f, 0.0000f, 0.0000f, 0.0000f},
    {2.0334f, 2.0537f, 1.9367f, 1.6638f, 1.3566f, 1.0626f, 0.8017f, 0.5820f,
     0.4049f, 0.2684f, 0.1683f, 0.0989f, 0.0539f, 0.0268f, 0.0119f, 0.0046f,
     0.0015f, 0.0004f, 0.0001f, 0.0000f, 0.0000f, 0.0000f, 0.0000f, 0.0000f},
    {1.8398f, 1.8634f, 1.7760f, 1.5476f, 1.2841f, 1.0273f, 0.7950f, 0.5949f,
     0.4292f, 0.2972f, 0.1963f, 0.1228f, 0.0721f, 0.0392f, 0.0195f, 0.0087f,
     0.0034f, 0.0011f, 0.0003f, 0.0001f, 0.0000f, 0.0000f, 0.0000f, 0.0000f},
    {1.5947f, 1.6211f, 1.5670f, 1.3910f, 1.1808f, 0.9708f, 0.7761f, 0.6035f,
     0.4557f, 0.3330f, 0.2345f, 0.1583f, 0.1017f, 0.0616f, 0.0349f, 0.0181f,
     0.0085f, 0.0035f, 0.0012f, 0.0003f, 0.0001f, 0.0000f, 0.0000f, 0.0000f},
    {1.3556f, 1.3833f, 1.3569f, 1.2277f, 1.0667f, 0.9015f, 0.7445f, 0.6014f,
     0.4747f, 0.3655f, 0.2736f, 0.1983f, 0.1385f, 0.0927f, 0.0589f, 0.0353f,
     0.0196f, 0.0099f, 0.0045f, 0.0017f, 0.0005f, 0.0001f, 0.0000f, 0.0000f},
    {1.1525f, 1.1805f, 1.1739f, 1.0809f, 0.9591f, 0.8308f, 0.7062f, 0.5898f,
     0.4839f, 0.3895f, 0.3070f, 0.2363f, 0.1769f, 0.1283f, 0.0897f, 0.0599f,
     0.0379f, 0.0225f, 0.0123f, 0.0060f, 0.0025f, 0.0008f, 0.0002f, 0.0000f},
    {0.9944f, 1.0219f, 1.0287f, 0.9617f, 0.8687f, 0.7685f, 0.6691f, 0.5745f,
     0.4866f, 0.4062f, 0.3338f, 0.2694f, 0.2130f, 0.1645f, 0.1236f, 0.0898f,
     0.0628f, 0.0418f, 0.0264f, 0.0153f, 0.0080f, 0.0035f, 0.0011f, 0.0001f},
    {0.8794f, 0.9066f, 0.9224f, 0.8733f, 0.8008f, 0.7206f, 0.6399f, 0.5619f,
     0.4882f, 0.4195f, 0.3561f, 0.2983f, 0.2461f, 0.1994f, 0.1582f, 0.1225f,
     0.0921f, 0.0668f, 0.0467f, 0.0308f, 0.0187f, 0.0100f, 0.0042f, 0.0008f},
    {0.8027f, 0.8297f, 0.8521f, 0.8153f, 0.7567f, 0.6905f, 0.6229f, 0.5568f,
     0.4936f, 0.4339f, 0.3780f, 0.3259f, 0.2777f, 0.2334f, 0.1931f, 0.1567f,
     0.1244f, 0.0962f, 0.0724f, 0.0523f, 0.0357f, 0.0222f, 0.0116f, 0.0040f},
    {0.7591f, 0.7866f, 0.8142f, 0.7859f, 0.7365f, 0.6794f, 0.6205f, 0.5625f,
     0.5066f, 0.4533f, 0.4028f, 0.3551f, 0.3102f, 0.2681f, 0.2289f, 0.1926f,
     0.1592f, 0.1290f, 0.1026f, 0.0792f, 0.0586f, 0.0406f, 0.0251f, 0.0120f},
    {0.7447f, 0.7732f, 0.8055f, 0.7827f, 0.7390f, 0.6875f, 0.6339f, 0.5809f,
     0.5295f, 0.4803f, 0.4333f, 0.3885f, 0.3459f, 0.3054f, 0.2670f, 0.2307f,
     0.1965f, 0.1650f, 0.1366f, 0.1108f, 0.0871f, 0.0653f, 0.0453f, 0.0270f},
    {0.7560f, 0.7859f, 0.8227f, 0.8032f, 0.7624f, 0.7137f, 0.6627f, 0.6121f,
     0.5629f, 0.5157f, 0.4705f, 0.4272f, 0.3858f, 0.3460f, 0.3078f, 0.2713f,
     0.2364f, 0.2036f, 0.1737f, 0.1461f, 0.1200f, 0.0953f, 0.0718f, 0.0493f},
    {0.7884f, 0.8200f, 0.8605f, 0.8426f, 0.8026f, 0.7542f, 0.7037f, 0.6535f,
     0.6049f, 0.5581f, 0.5133f, 0.4703f, 0.4289f, 0.3890f, 0.3505f, 0.3134f,
     0.2775f, 0.2436f, 0.2125f, 0.1833f, 0.1556f, 0.1288f, 0.1028f, 0.0776f},
    {0.8326f, 0.8658f, 0.9088f, 0.8910f, 0.8501f, 0.8008f, 0.7493f, 0.6983f,
     0.6490f, 0.6017f, 0.5564f, 0.5130f, 0.4712f, 0.4307f, 0.3916f, 0.3537f,
     0.3170f, 0.2821f, 0.2499f, 0.2197f, 0.1908f, 0.1628f, 0.1355f, 0.1089f},
    {0.8695f, 0.9033f, 0.9473f, 0.9290f, 0.8871f, 0.8367f, 0.7843f, 0.7326f,
     0.6828f, 0.6352f, 0.5897f, 0.5461f, 0.5041f, 0.4636f, 0.4243f, 0.3862f,
     0.3492f, 0.3139f, 0.2815f, 0.2511f, 0.2219f, 0.1936f, 0.1660f, 0.1392f},
    {0.8649f, 0.8982f, 0.9418f, 0.9241f, 0.8834f, 0.8345f, 0.7838f, 0.7339f,
     0.6859f, 0.6401f, 0.5964f, 0.5545f, 0.5143f, 0.4754f, 0.4377f, 0.4011f,
     0.3655f, 0.3316f, 0.3004f, 0.2712f, 0.2432f, 0.2161f, 0.1896f, 0.1640f}};
/* Of each row, none more than 1, weighed by the cosine. */
static const float means[ROWS] = {0.0207f, 0.0216f, 0.0245f, 0.0293f, 0.0361f, 0.0451f, 0.0567f, 0.0716f,
                                  0.0905f, 0.1141f, 0.1427f, 0.1761f, 0.2126f, 0.2491f, 0.2806f, 0.2996f};

/* The place of x in [0, 1] between two of `count` places: the first of them, and how far behind it. */
static int place_of(float x, int count, float *fraction)
{
    float at = x * (float)(count - 1);
    int place = int_min((int)at, count - 2);
    *fraction = at - (float)place;
    return place;
}

static float between(float a, float b, float fraction)
{
    return a + (b - a) * fraction;
}

static int row_of(float roughness, float *fraction)
{
    return place_of(sqrtf((roughness - LEAST_ROUGHNESS) / (1 - LEAST_ROUGHNESS)), ROWS, fraction);
}

float lobe_sheen_roughness(float roughness)
{
    return float_clamp(roughness, LEAST_ROUGHNESS, 1);
}

/* More than 1 close to the surface where the roughness is below 0.3. */
static float fitted_albedo(float cos, float roughness)
{
    float down, along;
    int row = row_of(roughness, &down), column = place_of(sqrtf(float_clamp(cos, 0, 1)), COLUMNS, &along);
    const float *upper = &albedos[row][column], *lower = &albedos[row + 1][column];
    return between(between(upper[0], upper[1], along), between(lower[0], lower[1], along), down);
}

float lobe_sheen_albedo(float cos, float roughness)
{
    return float_min(fitted_albedo(cos, roughness), 1);
}

float lobe_sheen_mean(float roughness)
{
    float down;
    int row = row_of(roughness, &down);
    return between(means[row], means[row + 1], down);
}

/* ---- covers -------------------------------------------------------------------------------------------- */

float lobe_cover_passes(const lobe_cover_t *cover, vec3_t wo, vec3_t wi)
{
    float passed = 1;
    if (cover->coat != 0) {
        vec3_t n = cover->coat_normal;
        float grazing = fresnel_schlick_weight(float_min(fabsf(v_dot(wo, n)), fabsf(v_dot(wi, n))));
        passed = 1 - cover->coat * (SCHLICK_COAT_F0 + (1 - SCHLICK_COAT_F0) * grazing);
    }
    if (cover->sheen != 0) {
        float most = float_max(lobe_sheen_albedo(fabsf(wo.z), cover->sheen_roughness),
                               lobe_sheen_albedo(fabsf(wi.z), cover->sheen_roughness));
        passed *= 1 - cover->sheen * most;
    }
    return passed;
}

float lobe_cover_mean(const lobe_cover_t *cover)
{
    float passed = 1 - cover->coat * (SCHLICK_COAT_F0 + (1 - SCHLICK_COAT_F0) / 21);
    return cover->sheen == 0 ? passed : passed * (1 - cover->sheen * lobe_sheen_mean(cover->sheen_roughness));
}

/* ---- the lobe ------------------------------------------------------------------------------------------ */

/* Of the logarithm of Lambda, fitted by Conty Estevez and Kulla at both ends of the roughness. */
static float fit(float x, float alpha)
{
    float smooth = (1 - alpha) * (1 - alpha);
    float a = between(21.5473f, 25.3245f, smooth), b = between(3.82987f, 3.32435f, smooth),
          c = between(0.19823f, 0.16801f, smooth), d = between(-1.97760f, -1.27393f, smooth),
          e = between(-4.32054f, -4.85967f, smooth);
    return a / (1 + b * powf(x, c)) + d * x + e;
}

static float lambda(float cos, float alpha)
{
    return expf(cos < 0.5f ? fit(cos, alpha) : 2 * fit(0.5f, alpha) - fit(1 - cos, alpha));
}

/* Density of normals whose squared sine is `sin2`, per steradian and unit area. */
static float distribution(float sin2, float alpha)
{
    float inverse = 1 / alpha;
    return (2 + inverse) * powf(sin2, 0.5f * inverse) * (0.5f * INV_PI_F);
}

static float square(float x)
{
    return x * x;
}

static bool eval_above(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    if (!(wo.z > 0 && wi.z > 0)) return false;
    float alpha = square(lobe->sheen.roughness), cos = v_normalize(v_add(wo, wi)).z;
    float co = float_max(wo.z, LEAST_COSINE), ci = float_max(wi.z, LEAST_COSINE);
    float shadowing = 1 / (1 + lambda(co, alpha) + lambda(ci, alpha));
    /* Where the fit would throw back more than it gets it is made so much weaker. */
    float roughness = lobe->sheen.roughness,
          gain = float_max(fitted_albedo(wo.z, roughness), fitted_albedo(wi.z, roughness));
    float f = lobe->sheen.factor / float_max(gain, 1) * distribution(float_max(0, 1 - cos * cos), alpha) *
              shadowing / (4 * co * ci) * lobe_cover_passes(&lobe->sheen.cover, wo, wi);
    value->f = vec3(f, f, f);
    value->pdf = value->pdf_rev = 0.5f * INV_PI_F;
    return true;
}

static bool draw_above(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    (void)lobe, (void)wo, (void)choice;
    *wi = warp_sphere(u);
    wi->z = fabsf(wi->z);
    return wi->z > 0;
}

const lobe_kind_t lobe_sheen = {.flags = LOBE_REFLECTS,
                                .eval = lobe_eval_mirrored,
                                .sample = lobe_sample_mirrored,
                                .eval_above = eval_above,
                                .draw_above = draw_above};
