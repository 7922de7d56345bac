/* response: see response.h. */
#include "worker/render/spectral/response.h"

/* The power of D65 at a place of the observer's table, in which 560 nm has 100; linear between its samples.
 */
static double d65_at(int i)
{
    int from = CIE_FIRST - CIE_D65_FIRST + i, sample = from / CIE_D65_STEP;
    double part = (double)(from % CIE_D65_STEP) / CIE_D65_STEP;
    return part > 0 ? (1 - part) * cie_d65[sample] + part * cie_d65[sample + 1] : cie_d65[sample];
}

/* From XYZ to the primaries of sRGB (IEC 61966-2-1), as the importer has them. Each channel's white is made
 * 1, which changes it by less than a thousandth. */
void response_init(response_t *response)
{
    static const double m[3][3] = {
        {3.240479, -1.537150, -0.498535}, {-0.969256, 1.875991, 0.041556}, {0.055648, -0.204043, 1.057311}};
    for (int i = 0; i < CIE_COUNT; i++) response->d65[i] = d65_at(i) / 100;
    for (int c = 0; c < 3; c++) {
        double white = 0;
        for (int i = 0; i < CIE_COUNT; i++) {
            response->light[c][i] =
                m[c][0] * cie_observer[0][i] + m[c][1] * cie_observer[1][i] + m[c][2] * cie_observer[2][i];
            white += response->light[c][i] * response->d65[i];
        }
        for (int i = 0; i < CIE_COUNT; i++) {
            response->light[c][i] /= white;
            response->white[c][i] = response->light[c][i] * response->d65[i];
        }
    }
}
