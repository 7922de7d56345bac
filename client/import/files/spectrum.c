/* spectrum: see spectrum.h. */
#include "client/import/files/spectrum.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/files/number.h"
#include "client/import/files/spectrum_data.h"

static const size_t largest_file = (size_t)1 << 24;
static const double largest_value = 1e30; /* its colour is a float still */

/* ---- samples ------------------------------------------------------------------------------------------- */

static spectrum_t allocate(size_t count)
{
    return (spectrum_t){mem_alloc(count * sizeof(double)), mem_alloc(count * sizeof(double)), count};
}

void spectrum_free(spectrum_t *spectrum)
{
    free(spectrum->lambda);
    free(spectrum->value);
    *spectrum = (spectrum_t){0};
}

typedef struct {
    double lambda, value;
    uint32_t line; /* where the wavelength stands */
} spectrum_sample_t;

static int compare_samples(const void *a, const void *b)
{
    const spectrum_sample_t *s = a, *t = b;
    if (s->lambda != t->lambda) return s->lambda < t->lambda ? -1 : 1;
    return s->line < t->line ? -1 : s->line > t->line;
}

static position_t on_line(position_t at, uint32_t line)
{
    return line == at.line ? at : (position_t){at.path, line, 0};
}

static result_t check_sample(const spectrum_sample_t *sample, position_t at)
{
    if (!isfinite(sample->lambda) || !isfinite(sample->value))
        return error_at(on_line(at, sample->line), "a spectrum takes finite numbers");
    if (sample->lambda < 0)
        return error_at(on_line(at, sample->line),
                        "a spectrum's wavelength is %g nm, but must not be negative", sample->lambda);
    if (fabs(sample->value) > largest_value)
        return error_at(on_line(at, sample->line), "a spectrum's value is %g; the limit is %g", sample->value,
                        largest_value);
    return result_ok();
}

/* Sorts the samples, of which there is at least one, and makes a spectrum of them. */
static result_t from_samples(spectrum_sample_t *samples, size_t count, position_t at, spectrum_t *out)
{
    for (size_t i = 0; i < count; ++i) TRY(check_sample(&samples[i], at));
    qsort(samples, count, sizeof *samples, compare_samples);
    for (size_t i = 1; i < count; ++i)
        if (samples[i].lambda == samples[i - 1].lambda)
            return error_at(on_line(at, samples[i].line),
                            "a spectrum has two values for %g nm; leave one out", samples[i].lambda);
    *out = allocate(count);
    for (size_t i = 0; i < count; ++i) {
        out->lambda[i] = samples[i].lambda;
        out->value[i] = samples[i].value;
    }
    return result_ok();
}

result_t spectrum_from_pairs(const double *numbers, size_t count, position_t at, spectrum_t *out)
{
    *out = (spectrum_t){0};
    if (count == 0) return error_at(at, "a spectrum takes pairs of wavelength and value, found none");
    if (count % 2)
        return error_at(at, "a spectrum takes pairs of wavelength and value, found %zu numbers", count);
    spectrum_sample_t *samples = mem_alloc(count / 2 * sizeof *samples);
    for (size_t i = 0; i < count / 2; ++i)
        samples[i] = (spectrum_sample_t){numbers[2 * i], numbers[2 * i + 1], at.line};
    result_t result = from_samples(samples, count / 2, at, out);
    free(samples);
    return result;
}

/* ---- files --------------------------------------------------------------------------------------------- */

/* The samples of a file as far as they are read. */
typedef struct {
    const char *at, *end;
    uint32_t line;
    spectrum_sample_t *samples;
    size_t count, capacity;
    bool half; /* the last sample has no value yet */
} reader_t;

static void store_number(reader_t *r, double number)
{
    if (r->half) {
        r->samples[r->count - 1].value = number;
    } else {
        r->samples = grow(r->samples, &r->capacity, r->count + 1, sizeof *r->samples);
        r->samples[r->count++] = (spectrum_sample_t){number, 0, r->line};
    }
    r->half = !r->half;
}

static result_t read_samples(reader_t *r, position_t file)
{
    while ((r->at = number_find(r->at, r->end, &r->line)) != NULL) {
        double number;
        const char *behind = number_parse_alone(r->at, r->end, &number);
        if (!behind)
            return error_at(on_line(file, r->line),
                            "expected a number: a spectrum file has pairs of wavelength and value, and "
                            "comments behind '#'");
        store_number(r, number);
        r->at = behind;
    }
    if (r->half)
        return error_at(on_line(file, r->samples[r->count - 1].line), "the wavelength %g nm has no value",
                        r->samples[r->count - 1].lambda);
    if (r->count == 0) return error_at(file, "the spectrum file has no numbers");
    return result_ok();
}

result_t spectrum_read(const char *path, spectrum_t *out)
{
    uint8_t *data;
    size_t size;
    position_t file = {path, 0, 0};
    *out = (spectrum_t){0};
    TRY(file_read(path, largest_file, &data, &size));
    reader_t r = {.at = (const char *)data, .end = (const char *)data + size, .line = 1};
    result_t result = read_samples(&r, file);
    if (result.code == RESULT_OK) result = from_samples(r.samples, r.count, file, out);
    free(r.samples);
    free(data);
    return result;
}

/* ---- spectra that have a name -------------------------------------------------------------------------- */

static const double photon_energy = 1239.84178; /* h c / e, eV nm: to 9 digits */

/* The second radiation constant h c / k in nm K, and that in which CIE's illuminant A is defined. */
static const double radiation_constant = 1.438777e7;
static const double radiation_constant_of_a = 1.435e7;
/* Planck's law per wavelength has its maximum at x = h c / (lambda k T) with x = 5 (1 - exp(-x)) (Wien). */
static const double wien_x = 4.965114231744276;

/* Planck's law in x = h c / (lambda k T), up to a factor; 0 where it can only underflow. */
static double planck(double x)
{
    return x > 1e-30 && x < 700 ? x * x * x * x * x / expm1(x) : 0;
}

/* CIE 15: 100 at 560 nm, 2848 K in the unit of 1931; tabulated at 5 nm. */
static spectrum_t illuminant_a(void)
{
    const double over_t = radiation_constant_of_a / 2848;
    spectrum_t s = allocate((830 - 300) / 5 + 1);
    for (size_t i = 0; i < s.count; ++i) {
        s.lambda[i] = 300 + 5 * (double)i;
        s.value[i] = 100 * planck(over_t / s.lambda[i]) / planck(over_t / 560);
    }
    return s;
}

static double grid_lambda(const spectrum_table_t *table, size_t i)
{
    if (table->grid == GRID_LISTED) return table->lambda[i];
    double place = table->first + table->step * (double)i;
    return table->grid == GRID_NANOMETRES ? place : photon_energy / place;
}

static spectrum_t from_table(const spectrum_table_t *table)
{
    spectrum_t s = allocate(table->count);
    for (size_t i = 0; i < table->count; ++i) {
        s.lambda[i] = grid_lambda(table, i);
        s.value[i] = table->value[i];
    }
    return s;
}

/* By 5 nm, and at the d line what the catalogue says. */
static spectrum_t from_glass(const spectrum_glass_t *glass)
{
    enum { FIRST = 300, STEP = 5, COUNT = 121, D_PLACE = (587 - FIRST) / STEP + 1 };
    spectrum_t s = allocate(COUNT + 1);
    for (size_t i = 0; i <= COUNT; ++i) {
        s.lambda[i] = i == D_PLACE ? SPECTRUM_D_LINE : FIRST + STEP * (double)(i < D_PLACE ? i : i - 1);
        double l2 = s.lambda[i] * s.lambda[i] * 1e-6, n2 = 1;
        for (int k = 0; k < 3; ++k) n2 += glass->b[k] * l2 / (l2 - glass->c[k]);
        s.value[i] = i == D_PLACE ? glass->d_line : sqrt(n2);
    }
    return s;
}

bool spectrum_named(const char *name, spectrum_t *out)
{
    *out = (spectrum_t){0};
    if (strcmp(name, "stdillum-A") == 0) {
        *out = illuminant_a();
        return true;
    }
    for (size_t i = 0; i < spectrum_glass_count; ++i)
        if (strcmp(name, spectrum_glasses[i].name) == 0) {
            *out = from_glass(&spectrum_glasses[i]);
            return true;
        }
    for (size_t i = 0; i < spectrum_table_count; ++i) {
        if (strcmp(name, spectrum_tables[i].name) != 0) continue;
        *out = from_table(&spectrum_tables[i]);
        return true;
    }
    return false;
}

/* ---- from spectra to XYZ ------------------------------------------------------------------------------- */

/* The value at a wavelength, given that no sample before *from lies just below it; moves *from forward. */
static double value_from(const spectrum_t *s, double lambda, size_t *from)
{
    if (lambda <= s->lambda[0]) return s->value[0];
    while (*from + 1 < s->count && s->lambda[*from + 1] <= lambda) ++*from;
    size_t i = *from;
    if (i + 1 == s->count) return s->value[i];
    double t = (lambda - s->lambda[i]) / (s->lambda[i + 1] - s->lambda[i]);
    return (1 - t) * s->value[i] + t * s->value[i + 1];
}

double spectrum_at(const spectrum_t *spectrum, double lambda)
{
    size_t from = 0;
    return value_from(spectrum, lambda, &from);
}

typedef struct {
    double v[3];
} triple_t;

static void add_wavelength(triple_t *xyz, size_t i, double power)
{
    for (int j = 0; j < 3; ++j) xyz->v[j] += power * cie_observer[j][i];
}

/* The tristimulus values of a spectrum, times another one when that is not NULL; ybar's integral is 1. */
static triple_t xyz_of(const spectrum_t *s, const spectrum_t *light)
{
    triple_t xyz = {{0, 0, 0}};
    double whole = 0;
    size_t from = 0, light_from = 0;
    for (size_t i = 0; i < CIE_COUNT; ++i) {
        double lambda = CIE_FIRST + (double)i;
        double power = value_from(s, lambda, &from);
        add_wavelength(&xyz, i, light ? power * value_from(light, lambda, &light_from) : power);
        whole += cie_observer[1][i];
    }
    for (int j = 0; j < 3; ++j) xyz.v[j] /= whole;
    return xyz;
}

/* ---- from XYZ to linear sRGB --------------------------------------------------------------------------- */

/* The primaries of sRGB and its white (IEC 61966-2-1, ITU-R BT.709), to the digits that pbrt-v3 has. */
static triple_t rgb_from_xyz(triple_t xyz)
{
    static const double m[3][3] = {
        {3.240479, -1.537150, -0.498535}, {-0.969256, 1.875991, 0.041556}, {0.055648, -0.204043, 1.057311}};
    triple_t rgb;
    for (int i = 0; i < 3; ++i) rgb.v[i] = m[i][0] * xyz.v[0] + m[i][1] * xyz.v[1] + m[i][2] * xyz.v[2];
    return rgb;
}

/* The linear sRGB, times `scale`, in relation to that of a white; a primary's strength is all that changes
 * when the white does. */
static triple_t relative_to(triple_t rgb, triple_t white, double scale)
{
    for (int i = 0; i < 3; ++i) rgb.v[i] *= scale / white.v[i];
    return rgb;
}

static rgb_t clipped(triple_t rgb)
{
    return vec3((float)fmax(rgb.v[0], 0), (float)fmax(rgb.v[1], 0), (float)fmax(rgb.v[2], 0));
}

static triple_t d65_xyz(spectrum_t *d65)
{
    (void)spectrum_named("stdillum-D65", d65);
    return xyz_of(d65, NULL);
}

/* A light's colour with luminance 1, where D65 is (1, 1, 1). */
static rgb_t of_unit_luminance(triple_t xyz)
{
    spectrum_t d65;
    triple_t white = d65_xyz(&d65);
    spectrum_free(&d65);
    double scale = white.v[1] / xyz.v[1];
    if (!isfinite(scale)) return vec3(0, 0, 0); /* it has no light, or next to none */
    return clipped(relative_to(rgb_from_xyz(xyz), rgb_from_xyz(white), scale));
}

/* pbrt-v3 sums 471 samples as if they spanned 470 nm. */
static const float v3_sum = 470.0f / 471.0f;

double spectrum_emission_scale(const spectrum_t *spectrum, spectrum_rules_t rules)
{
    spectrum_t d65;
    triple_t white = d65_xyz(&d65);
    spectrum_free(&d65);
    double part = rules == SPECTRUM_PBRT_V3 ? (double)v3_sum : 1 / xyz_of(spectrum, NULL).v[1];
    double scale = part * white.v[1] / 100;
    return isfinite(scale) ? scale : 0;
}

bool spectrum_resample(const spectrum_t *spectrum, double scale, blob_spectrum_t *out)
{
    const double largest = 1e9;
    double sums[BLOB_SPECTRUM_SAMPLES] = {0}, weights[BLOB_SPECTRUM_SAMPLES] = {0};
    size_t from = 0;
    for (int i = 0; i < CIE_COUNT; ++i) {
        double part = (double)(i % BLOB_SPECTRUM_STEP) / BLOB_SPECTRUM_STEP;
        double value = fmax(0, scale * value_from(spectrum, CIE_FIRST + i, &from));
        for (int side = 0; side < 2; ++side) {
            int sample = i / BLOB_SPECTRUM_STEP + side;
            double weight = side == 0 ? 1 - part : part;
            if (!(weight > 0)) continue;
            sums[sample] += weight * value;
            weights[sample] += weight;
        }
    }
    for (int i = 0; i < BLOB_SPECTRUM_SAMPLES; ++i) {
        double mean = sums[i] / weights[i];
        if (!(mean <= largest)) return false;
        out->samples[i] = (float)mean;
    }
    return true;
}

static rgb_t under_d65(const spectrum_t *s)
{
    spectrum_t d65;
    triple_t white = d65_xyz(&d65), seen = xyz_of(s, &d65);
    spectrum_free(&d65);
    return clipped(relative_to(rgb_from_xyz(seen), rgb_from_xyz(white), 1));
}

void spectrum_reflectance_weights(const double *lambda, size_t count, double *weights)
{
    spectrum_t d65, s = allocate(count);
    triple_t white = rgb_from_xyz(d65_xyz(&d65));
    for (size_t i = 0; i < count; ++i) {
        s.lambda[i] = lambda[i];
        s.value[i] = 0;
    }
    for (size_t i = 0; i < count; ++i) {
        s.value[i] = 1;
        triple_t rgb = relative_to(rgb_from_xyz(xyz_of(&s, &d65)), white, 1);
        s.value[i] = 0;
        for (size_t c = 0; c < 3; ++c) weights[3 * i + c] = rgb.v[c];
    }
    spectrum_free(&s);
    spectrum_free(&d65);
}

rgb_t spectrum_colour(const spectrum_t *spectrum, spectrum_use_t use, spectrum_rules_t rules)
{
    if (rules == SPECTRUM_PBRT_V3) return v_scale(clipped(rgb_from_xyz(xyz_of(spectrum, NULL))), v3_sum);
    if (use == SPECTRUM_EMISSION) return of_unit_luminance(xyz_of(spectrum, NULL));
    return under_d65(spectrum);
}

spectrum_t spectrum_of_blackbody(double kelvin)
{
    spectrum_t s = allocate(CIE_COUNT);
    for (size_t i = 0; i < CIE_COUNT; ++i) {
        s.lambda[i] = CIE_FIRST + (double)i;
        s.value[i] = planck(radiation_constant / kelvin / s.lambda[i]) / planck(wien_x);
    }
    return s;
}

rgb_t spectrum_blackbody(double kelvin, spectrum_rules_t rules)
{
    if (!(kelvin > 0)) return vec3(0, 0, 0);
    spectrum_t s = spectrum_of_blackbody(kelvin);
    rgb_t rgb = spectrum_colour(&s, SPECTRUM_EMISSION, rules);
    spectrum_free(&s);
    return rgb;
}

rgb_t spectrum_glow(double kelvin)
{
    if (!(kelvin > 0)) return vec3(0, 0, 0);
    spectrum_t s = spectrum_of_blackbody(kelvin), d65;
    triple_t white = d65_xyz(&d65), seen = xyz_of(&s, NULL);
    spectrum_free(&d65);
    spectrum_free(&s);
    return clipped(
        relative_to(rgb_from_xyz(seen), rgb_from_xyz(white), white.v[1] * SPECTRUM_LUMINANCE_OF_1));
}
