/* waves: the wavelengths of a sample of a spectral job, where colours become spectra, and where light becomes
 * linear sRGB again.
 *
 * DESIGN. Everything that carries light has three channels: red, green and blue, or in a spectral job three
 * wavelengths. So all that happens in between is the same code, and a job in RGB is not touched. Colours
 * enter by waves_reflectance, waves_coefficient and waves_light, measured spectra by waves_spectrum; light
 * leaves by waves_colour, when it is added to the film.
 *
 * The wavelengths of a sample are three numbers a third apart, by which a density draws wavelengths (hero
 * wavelength sampling: Wilkie, Nawaz, Droske, Weidlich and Hanika 2014). It follows what D65 adds to linear
 * sRGB, so that each of them counts about the same. Given the wavelengths, all densities of a path are those
 * of all three together, as are the weights of strategies: nothing else needs to know that there is a hero.
 */
#ifndef LIGHTMILL_WAVES_H
#define LIGHTMILL_WAVES_H

#include "common/scene/blob_format.h"
#include "worker/render/spectral/upsample.h"

enum { WAVES = 3 };

/* What all samples of spectral jobs share. */
typedef struct waves_tables waves_tables_t;

waves_tables_t *waves_tables_new(void);
/* Frees the tables and sets *tables to NULL. */
void waves_tables_destroy(waves_tables_t **tables);

/* The wavelengths of a sample. A pointer that is NULL stands for red, green and blue. */
typedef struct {
    const upsampling_t *upsampling;
    float nm[WAVES];       /* from CIE_FIRST on */
    float place[WAVES];    /* as upsampled_at takes it */
    rgb_t white;           /* power of D65; 1 at 560 nm */
    rgb_t response[WAVES]; /* what light of power 1 at each of them adds to linear sRGB: over its density */
} waves_t;

/* Draws them by a number in [0, 1). The tables must outlive them. */
waves_t waves_draw(const waves_tables_t *tables, float u);

/* What stands in a channel for each wavelength of the given colour: a share of light; what is not bounded,
 * such as an index of metal or what absorbs; light. None of these takes NULL. */
rgb_t waves_reflectance(const waves_t *waves, rgb_t colour);
rgb_t waves_coefficient(const waves_t *waves, rgb_t colour);
rgb_t waves_light(const waves_t *waves, rgb_t colour);
/* A measured spectrum of a blob. */
rgb_t waves_spectrum(const waves_t *waves, const blob_spectrum_t *spectrum);
/* Linear sRGB that the film shows of light in the channels. */
static inline rgb_t waves_colour(const waves_t *waves, rgb_t light)
{
    return v_add(v_scale(waves->response[0], light.x),
                 v_add(v_scale(waves->response[1], light.y), v_scale(waves->response[2], light.z)));
}

#endif
