/* lobe_fourier: a BSDF from a table of Fourier series (blob_fourier_t), as pbrt-v3 evaluates it: splines of
 * Catmull and Rom through the nodes of both cosines, and between the series of up to 16 pairs of nodes a sum.
 * Of three channels the first is the luminance; green is what red and blue leave of it.
 *
 * Tables are reciprocal only about: importance is scattered as the table says of radiance on the same way
 * back. So what a light sends to the eye is the same, whichever end a path is made from.
 *
 * Directions are drawn from cells of constant density that come with the table, with the density of the two
 * outgoing nodes beside the cosine, each in proportion to how near it is.
 * (client/import/files/fourier_table.c says why not by the series themselves, as pbrt does.) */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/sampling/interval.h"

/* ---- values -------------------------------------------------------------------------------------------- */

/* Between which nodes a cosine lies, and where between them, 0 to 1; false when it is beyond them. */
static bool find_nodes(const lobe_fourier_t *f, float mu, uint32_t *low, float *t)
{
    const float *nodes = f->numbers + f->table->first_node;
    uint32_t last = f->table->nodes - 1;
    if (!(mu >= nodes[0] && mu <= nodes[last])) return false;
    *low = interval_find(nodes, last, mu);
    *t = float_min((mu - nodes[*low]) / (nodes[*low + 1] - nodes[*low]), 1);
    return true;
}

/* The nodes that a spline goes by, `first` on, and their weights; nodes that are not there have none. */
typedef struct {
    int32_t first;
    float weights[4];
} spline_t;

/* A node's slope is that of the line through its neighbours; at an end, that of the interval. */
static bool find_spline(const lobe_fourier_t *f, float mu, spline_t *s)
{
    uint32_t i;
    float t;
    if (!find_nodes(f, mu, &i, &t)) return false;
    const float *nodes = f->numbers + f->table->first_node;
    bool before = i > 0, behind = i + 2 < f->table->nodes;
    float t2 = t * t, t3 = t2 * t, width = nodes[i + 1] - nodes[i];
    float start = t3 - 2 * t2 + t, end = t3 - t2; /* what the slopes at both ends count */
    if (before) start *= width / (nodes[i + 1] - nodes[i - 1]);
    if (behind) end *= width / (nodes[i + 2] - nodes[i]);
    float rise = 3 * t2 - 2 * t3;
    s->first = (int32_t)i - 1;
    s->weights[0] = before ? -start : 0;
    s->weights[1] = 1 - rise - end - (before ? 0 : start);
    s->weights[2] = rise + start + (behind ? 0 : end);
    s->weights[3] = behind ? end : 0;
    return true;
}

enum { BLOCK = 64 };

/* A series with its weight in a sum. */
typedef struct {
    const float *coefficients;
    uint32_t count;
    float weight;
} term_t;

/* The series that two splines go by. */
static int find_terms(const lobe_fourier_t *f, const spline_t *in, const spline_t *out, term_t terms[16],
                      uint32_t *longest)
{
    int count = 0;
    *longest = 0;
    for (int o = 0; o < 4; o++)
        for (int i = 0; i < 4; i++) {
            float weight = in->weights[i] * out->weights[o];
            if (weight == 0) continue;
            const blob_series_t *s =
                &f->series[(size_t)(out->first + o) * f->table->nodes + (size_t)(in->first + i)];
            if (s->count == 0) continue;
            terms[count++] = (term_t){f->numbers + s->first, s->count, weight};
            if (s->count > *longest) *longest = s->count;
        }
    return count;
}

/* Adds the coefficients of one block of a channel to `sums`. */
static void add_block(const term_t *term, uint32_t channel, uint32_t first, float sums[BLOCK])
{
    if (first >= term->count) return;
    const float *a = term->coefficients + (size_t)channel * term->count + first;
    uint32_t count = term->count - first < BLOCK ? term->count - first : BLOCK;
    for (uint32_t k = 0; k < count; k++) sums[k] += term->weight * a[k];
}

/* The sum of all terms at an azimuth, for each channel. cos(k phi) by Chebyshev's recurrence, which takes
 * double precision. */
static void sum_series(const term_t *terms, int count, uint32_t longest, uint32_t channels, float phi,
                       double values[3])
{
    double cosine = cos((double)phi), before = cosine, now = 1;
    for (uint32_t first = 0; first < longest; first += BLOCK) {
        float sums[3][BLOCK] = {{0}};
        uint32_t end = longest - first < BLOCK ? longest - first : BLOCK;
        for (int i = 0; i < count; i++)
            for (uint32_t c = 0; c < channels; c++) add_block(&terms[i], c, first, sums[c]);
        for (uint32_t k = 0; k < end; k++) {
            for (uint32_t c = 0; c < channels; c++) values[c] += (double)sums[c][k] * now;
            double next = 2 * cosine * now - before;
            before = now;
            now = next;
        }
    }
}

/* Of radiance that arrives in a direction of cosine mu_i and leaves in one of mu_o: without the cosine, so
 * divided by |mu_i|. It is scaled by the square of the indices where it goes through. */
static rgb_t radiance_value(const lobe_fourier_t *f, float mu_i, float mu_o, float phi)
{
    const float grazing = 1e-9f;
    spline_t in, out;
    term_t terms[16];
    uint32_t longest;
    double values[3] = {0, 0, 0};
    if (!(fabsf(mu_i) > grazing) || !find_spline(f, mu_i, &in) || !find_spline(f, mu_o, &out))
        return vec3(0, 0, 0);
    int count = find_terms(f, &in, &out, terms, &longest);
    sum_series(terms, count, longest, f->table->channels, phi, values);
    float scale = 1 / fabsf(mu_i), y = float_max((float)values[0], 0);
    if (mu_i * mu_o > 0) {
        float eta = mu_i > 0 ? 1 / f->table->eta : f->table->eta;
        scale *= eta * eta;
    }
    if (f->table->channels == 1) return v_scale(f->factor, y * scale);
    float r = (float)values[1], b = (float)values[2], g = 1.39829f * y - 0.100913f * b - 0.297375f * r;
    rgb_t value = vec3(float_max(r, 0) * scale, float_max(g, 0) * scale, float_max(b, 0) * scale);
    return v_mul(f->factor, f->waves == NULL ? value : waves_coefficient(f->waves, value));
}

/* ---- densities ----------------------------------------------------------------------------------------- */

/* The one of `count` cells that u falls into, whose cumulative sums are one more; *u is stretched to [0, 1)
 * again. */
static uint32_t find_cell(const float *sums, uint32_t count, float *u)
{
    uint32_t cell = interval_find(sums, count, *u);
    *u = float_clamp((*u - sums[cell]) / (sums[cell + 1] - sums[cell]), 0, 0x1.fffffep-1f);
    return cell;
}

static float azimuth_edge(uint32_t k)
{
    float t = (float)k / FOURIER_AZIMUTHS;
    return PI_F * t * t;
}

static const float *marginal_of(const lobe_fourier_t *f, uint32_t outgoing)
{
    return f->numbers + f->table->first_marginal + (size_t)outgoing * f->table->nodes;
}

static const float *conditional_of(const lobe_fourier_t *f, uint32_t outgoing, uint32_t cell)
{
    size_t row = (size_t)outgoing * (f->table->nodes - 1) + cell;
    return f->numbers + f->table->first_conditional + row * (FOURIER_AZIMUTHS + 1);
}

/* Of light that leaves along mu_o: the density, per steradian, of looking for it where it arrives along mu_i,
 * at an azimuth of `phi` from there. */
static float density(const lobe_fourier_t *f, float mu_o, float mu_i, float phi)
{
    uint32_t o, i, k = (uint32_t)(sqrtf(phi * INV_PI_F) * FOURIER_AZIMUTHS);
    float t, unused, sum = 0;
    if (!find_nodes(f, mu_o, &o, &t) || !find_nodes(f, mu_i, &i, &unused)) return 0;
    if (k >= FOURIER_AZIMUTHS) k = FOURIER_AZIMUTHS - 1;
    for (uint32_t n = 0; n < 2; n++) {
        const float *rows = marginal_of(f, o + n), *cells = conditional_of(f, o + n, i);
        sum += (n == 0 ? 1 - t : t) * (rows[i + 1] - rows[i]) * (cells[k + 1] - cells[k]);
    }
    const float *nodes = f->numbers + f->table->first_node;
    return sum / (2 * (nodes[i + 1] - nodes[i]) * (azimuth_edge(k + 1) - azimuth_edge(k)));
}

/* ---- directions ---------------------------------------------------------------------------------------- */

/* A direction's azimuth as a unit vector; that of a direction without one is the x axis. */
static vec2_t azimuth(vec3_t w)
{
    float length2 = w.x * w.x + w.y * w.y;
    if (!(length2 > 1e-20f)) return (vec2_t){1, 0};
    float scale = 1 / sqrtf(length2);
    return (vec2_t){w.x * scale, w.y * scale};
}

/* The angle between the azimuths of two directions, 0 to pi. */
static float azimuth_between(vec3_t v, vec3_t w)
{
    vec2_t a = azimuth(v), b = azimuth(w);
    return fabsf(atan2f(a.x * b.y - a.y * b.x, a.x * b.x + a.y * b.y));
}

/* Nobody needs a direction that brings nothing, unless another lobe scatters there. */
static bool is_useless(const lobe_t *lobe, rgb_t f)
{
    return v_is_zero(f) && lobe->chance == 1;
}

static bool eval(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    const lobe_fourier_t *f = &lobe->fourier;
    vec3_t to = mode == TRANSPORT_RADIANCE ? wo : wi, from = mode == TRANSPORT_RADIANCE ? wi : wo;
    float phi = azimuth_between(v_neg(wi), wo);
    (void)reflect;
    value->f = radiance_value(f, -from.z, to.z, phi);
    value->pdf = density(f, wo.z, -wi.z, phi);
    value->pdf_rev = density(f, wi.z, -wo.z, phi);
    return lobe_is_sane(value) && (value->pdf > 0 || value->pdf_rev > 0 || !v_is_zero(value->f)) &&
           !is_useless(lobe, value->f);
}

/* The direction of light that arrives along mu_i and is turned by `phi` from the azimuth of wo. */
static vec3_t direction_from(vec3_t wo, float mu_i, float phi)
{
    vec2_t a = azimuth(wo);
    float r = sqrtf(float_max(0, 1 - mu_i * mu_i)), c = cosf(phi), s = sinf(phi);
    return vec3(-r * (c * a.x - s * a.y), -r * (s * a.x + c * a.y), -mu_i);
}

static bool sample(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *sample)
{
    const lobe_fourier_t *f = &lobe->fourier;
    const float *nodes = f->numbers + f->table->first_node;
    uint32_t o;
    float t;
    if (!find_nodes(f, wo.z, &o, &t)) return false;
    if (choice < t) o++;
    float side = u.y < 0.5f ? 1 : -1;
    u.y = u.y < 0.5f ? 2 * u.y : 2 * u.y - 1;
    uint32_t i = find_cell(marginal_of(f, o), f->table->nodes - 1, &u.x);
    uint32_t k = find_cell(conditional_of(f, o, i), FOURIER_AZIMUTHS, &u.y);
    float mu = nodes[i] + u.x * (nodes[i + 1] - nodes[i]), low = azimuth_edge(k);
    vec3_t wi = direction_from(wo, mu, side * (low + u.y * (azimuth_edge(k + 1) - low)));
    bsdf_value_t value;
    if (wi.z == 0 || !eval(lobe, wo, wi, wo.z * wi.z > 0, mode, &value) || !(value.pdf > 0)) return false;
    *sample = (bsdf_sample_t){.wi = wi,
                              .weight = v_scale(value.f, fabsf(wi.z) / value.pdf),
                              .pdf = value.pdf,
                              .pdf_rev = value.pdf_rev};
    return true;
}

const lobe_kind_t lobe_fourier = {.flags = LOBE_REFLECTS | LOBE_TRANSMITS, .eval = eval, .sample = sample};
