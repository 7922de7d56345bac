/* waves: see waves.h. */
#include "worker/render/spectral/waves.h"

#include "common/base.h"
#include "worker/render/spectral/response.h"

#include <stdlib.h>

enum { BINS = CIE_COUNT - 1 };

struct waves_tables {
    float up_to[BINS + 1]; /* the chance of a wavelength below CIE_FIRST + i; even within a nanometre */
    float white[CIE_COUNT];
    rgb_t response[CIE_COUNT];
    upsampling_t *upsampling;
};

/* The density goes with the length of what a nanometre of D65 adds to linear sRGB. */
static void share_out(waves_tables_t *tables, const response_t *response)
{
    double density[BINS], sum = 0, so_far = 0;
    for (int i = 0; i < BINS; i++) {
        double square = 0;
        for (int c = 0; c < 3; c++) {
            double value = response->white[c][i] + response->white[c][i + 1];
            square += value * value;
        }
        sum += density[i] = sqrt(square);
    }
    for (int i = 0; i < BINS; i++) {
        tables->up_to[i] = (float)(so_far / sum);
        so_far += density[i];
    }
    tables->up_to[BINS] = 1;
}

waves_tables_t *waves_tables_new(void)
{
    waves_tables_t *tables = mem_alloc(sizeof *tables);
    response_t response;
    response_init(&response);
    share_out(tables, &response);
    for (int i = 0; i < CIE_COUNT; i++) {
        tables->white[i] = (float)response.d65[i];
        tables->response[i] =
            vec3((float)response.light[0][i], (float)response.light[1][i], (float)response.light[2][i]);
    }
    tables->upsampling = upsampling_new();
    return tables;
}

void waves_tables_destroy(waves_tables_t **tables)
{
    if (*tables == NULL) return;
    upsampling_destroy(&(*tables)->upsampling);
    free(*tables);
    *tables = NULL;
}

/* The bin that a number falls into. */
static int find_bin(const waves_tables_t *tables, float u)
{
    int low = 0, high = BINS;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (tables->up_to[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    return low;
}

waves_t waves_draw(const waves_tables_t *tables, float u)
{
    waves_t waves = {.upsampling = tables->upsampling};
    float white[WAVES];
    for (int k = 0; k < WAVES; k++) {
        float at = u + (float)k / WAVES;
        if (at >= 1) at -= 1;
        int bin = find_bin(tables, at);
        float chance = tables->up_to[bin + 1] - tables->up_to[bin];
        float part = float_clamp((at - tables->up_to[bin]) / chance, 0, 1);
        waves.nm[k] = (float)(CIE_FIRST + bin) + part;
        waves.place[k] = 2 * ((float)bin + part) / BINS - 1;
        white[k] = (1 - part) * tables->white[bin] + part * tables->white[bin + 1];
        waves.response[k] =
            v_scale(v_add(v_scale(tables->response[bin], 1 - part), v_scale(tables->response[bin + 1], part)),
                    1 / (WAVES * chance));
    }
    waves.white = vec3(white[0], white[1], white[2]);
    return waves;
}

static rgb_t all_places(const waves_t *waves, const upsampled_t *s)
{
    return vec3(upsampled_at(s, waves->place[0]), upsampled_at(s, waves->place[1]),
                upsampled_at(s, waves->place[2]));
}

rgb_t waves_reflectance(const waves_t *waves, rgb_t colour)
{
    upsampled_t s = upsample_reflectance(waves->upsampling, colour);
    return all_places(waves, &s);
}

rgb_t waves_coefficient(const waves_t *waves, rgb_t colour)
{
    upsampled_t s = upsample_unbounded(waves->upsampling, colour);
    return all_places(waves, &s);
}

rgb_t waves_spectrum(const waves_t *waves, const blob_spectrum_t *spectrum)
{
    float at[WAVES];
    for (int k = 0; k < WAVES; k++) {
        float place = (waves->nm[k] - BLOB_SPECTRUM_FIRST) / BLOB_SPECTRUM_STEP;
        int sample = int_min((int)place, BLOB_SPECTRUM_SAMPLES - 2);
        float part = place - (float)sample;
        at[k] = (1 - part) * spectrum->samples[sample] + part * spectrum->samples[sample + 1];
    }
    return vec3(at[0], at[1], at[2]);
}

rgb_t waves_light(const waves_t *waves, rgb_t colour)
{
    return v_mul(waves_coefficient(waves, colour), waves->white);
}
