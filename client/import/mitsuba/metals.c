/* metals: see metals.h. */
#include "client/import/mitsuba/metals.h"

#include <stdio.h>
#include <string.h>

#include "client/import/files/spectrum.h"

/* Measured: Palik (1998), "Handbook of Optical Constants of Solids", by way of luxpop.com, whose spectra have
 * been made colours. Metals of which pbrt-v4 has spectra are not among them. */
static const struct {
    const char *name;
    rgb_t eta, k;
} metals[] = {
    {"AlAs", {3.597f, 3.226f, 2.212f}, {0.0006655f, 0, 0.007409f}},
    {"AlSb", {4.708f, 4.052f, 4.574f}, {0, 0.09345f, 1.298f}},
    {"Be", {4.176f, 3.178f, 2.778f}, {3.827f, 3.004f, 2.863f}},
    {"Cr", {4.36f, 2.911f, 1.651f}, {5.195f, 4.222f, 3.747f}},
    {"CsI", {2.14f, 1.699f, 1.659f}, {0, 0, 0}},
    {"Cu2O", {3.544f, 2.944f, 2.746f}, {0.114f, 0.1934f, 0.6047f}},
    {"CuO", {3.241f, 2.443f, 2.206f}, {0.52f, 0.5688f, 0.7206f}},
    {"Hg", {2.394f, 1.437f, 0.9076f}, {6.314f, 4.363f, 3.415f}},
    {"HgTe", {4.769f, 3.224f, 2.654f}, {1.629f, 1.577f, 1.726f}},
    {"Ir", {3.08f, 2.078f, 1.614f}, {5.58f, 4.059f, 3.26f}},
    {"K", {0.06391f, 0.04631f, 0.0381f}, {2.1f, 1.346f, 0.9113f}},
    {"Li", {0.2653f, 0.1952f, 0.2204f}, {3.533f, 2.306f, 1.665f}},
    {"Mo", {4.474f, 3.518f, 2.77f}, {4.102f, 3.414f, 3.144f}},
    {"Na", {0.06014f, 0.05602f, 0.06186f}, {3.173f, 2.108f, 1.576f}},
    {"Nb", {3.413f, 2.784f, 2.391f}, {3.434f, 2.732f, 2.574f}},
    {"Ni", {2.362f, 1.66f, 1.464f}, {4.489f, 3.044f, 2.34f}},
    {"Rh", {2.58f, 1.856f, 1.551f}, {6.768f, 4.693f, 3.968f}},
    {"Se", {4.08f, 2.833f, 2.815f}, {0.7538f, 0.6371f, 0.5205f}},
    {"Se-e", {5.752f, 4.152f, 4.073f}, {0.8698f, 1.103f, 1.562f}},
    {"SiC", {3.166f, 2.521f, 2.474f}, {0, 0, 0}},
    {"SnTe", {4.516f, 1.977f, 1.279f}, {0, 0, 0}},
    {"Ta", {2.058f, 2.388f, 2.623f}, {2.403f, 1.738f, 1.943f}},
    {"Te", {7.375f, 4.473f, 2.631f}, {3.249f, 3.52f, 3.285f}},
    {"Te-e", {7.493f, 4.287f, 2.365f}, {5.572f, 4.937f, 3.989f}},
    {"ThF4", {1.827f, 1.439f, 1.385f}, {0, 0, 0}},
    {"TiC", {3.693f, 2.831f, 2.577f}, {3.259f, 2.347f, 2.168f}},
    {"TiN", {1.645f, 1.148f, 1.377f}, {3.361f, 1.939f, 1.1f}},
    {"TiO2-e", {3.1f, 2.508f, 2.577f}, {0, 0, 0.0001772f}},
    {"VC", {3.65f, 2.747f, 2.527f}, {3.062f, 2.194f, 1.959f}},
    {"VN", {2.86f, 2.115f, 1.936f}, {3.026f, 2.052f, 1.613f}},
    {"V", {4.268f, 3.506f, 2.755f}, {3.484f, 2.883f, 3.105f}},
    {"W", {4.361f, 3.293f, 2.992f}, {3.493f, 2.599f, 2.268f}},
    {"a-C", {2.938f, 2.222f, 1.964f}, {0.8855f, 0.7976f, 0.8136f}},
    {"d-C", {2.9f, 2.293f, 2.223f}, {0, 0, 0}},
};

/* The measured spectra of pbrt-v4, whose names differ. */
static bool index_of_spectrum(const char *name, rgb_t *eta, rgb_t *k)
{
    rgb_t *const indices[] = {eta, k};
    spectrum_t spectrum;
    char text[64];
    for (int i = 0; i < 2; ++i) {
        snprintf(text, sizeof text, "metal-%.20s-%s", name, i == 0 ? "eta" : "k");
        if (!spectrum_named(text, &spectrum)) return false;
        *indices[i] = spectrum_colour(&spectrum, SPECTRUM_INDEX, SPECTRUM_PBRT_V3);
        spectrum_free(&spectrum);
    }
    return true;
}

bool metal_index(const char *name, rgb_t *eta, rgb_t *k)
{
    static const char ending[] = "_palik";
    char base[32];
    size_t length = strlen(name), cut = sizeof ending - 1;
    if (length > cut && strcmp(name + length - cut, ending) == 0) length -= cut;
    snprintf(base, sizeof base, "%.*s", (int)(length < 20 ? length : 20), name);
    if (index_of_spectrum(base, eta, k)) return true;
    for (size_t i = 0; i < ARRAY_LENGTH(metals); ++i) {
        if (strcmp(base, metals[i].name) != 0) continue;
        *eta = metals[i].eta;
        *k = metals[i].k;
        return true;
    }
    return false;
}
