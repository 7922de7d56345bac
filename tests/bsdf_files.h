/* bsdf_files: files of tabulated BSDFs, made of formulas. */
#ifndef LIGHTMILL_BSDF_FILES_H
#define LIGHTMILL_BSDF_FILES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What scatters from the cosine mu_i, of the direction in which light arrives, to mu_o, in which it leaves,
 * at azimuths that differ by phi; with the cosine of mu_i. channel 0: luminance, 1: red, 2: blue. */
typedef double fourier_formula_t(double mu_i, double mu_o, double phi, int channel);

/* The header of a file in pbrt-v3's format, from its first byte. */
typedef struct {
    char identifier[7];
    uint8_t version;
    uint32_t flags, nodes, coefficients, longest, channels, bases;
    uint32_t unread[3];
    float eta;
    uint32_t unread_either[4];
} fourier_header_t;

/* Such a file in fresh memory, with series of `terms` terms at most, of the formula at `nodes` cosines from
 * -1 to 1, which are denser towards these. */
uint8_t *fourier_file(uint32_t nodes, uint32_t channels, uint32_t terms, float eta,
                      fourier_formula_t *formula, size_t *size);
/* The cosine of one of these nodes. */
float fourier_node(uint32_t nodes, uint32_t node);

/* Formulas. A white Lambertian surface; and one that is coloured, scatters both ways, more about the mirror
 * direction and straight on, and is reciprocal; the same, but not reciprocal. */
double fourier_white(double mu_i, double mu_o, double phi, int channel);
double fourier_glossy(double mu_i, double mu_o, double phi, int channel);
double fourier_skewed(double mu_i, double mu_o, double phi, int channel);

/* A file in pbrt-v4's format: an isotropic rough surface, or one whose roughness depends on the azimuth. Its
 * spectra are `level`, times the luminance, at all wavelengths, or fall towards red. */
uint8_t *measured_file(bool isotropic, bool red, double level, size_t *size);

#endif
