/* fuzz_lens: any text as a lens file. What is accepted can be focused or not, and rays go through it, or do
 * not: those that do are finite. */
#include "tests/fuzz/fuzz.h"

#include "client/import/files/lens_file.h"
#include "client/import/scene/lens.h"

static void trace_through(const lens_t *lens, const blob_pupil_t *pupil, double film)
{
    for (int i = 0; i < 16; ++i) {
        double x = (double)pupil->x_min + (double)(pupil->x_max - pupil->x_min) * (i % 4) / 3,
               y = (double)pupil->y_min + (double)(pupil->y_max - pupil->y_min) * (i / 4) / 3;
        lens_ray_t ray = {{film, 0, 0}, {x - film, y, lens_rear(lens)}};
        float share = lens_trace_from_film(lens, &ray);
        fuzz_expect(share == 0 || share == 1, "a round stop lets a part of a ray through");
        if (share == 0) continue;
        lens_vec_t o = ray.origin, d = ray.direction;
        fuzz_expect(isfinite(o.x) && isfinite(o.y) && isfinite(o.z) && isfinite(d.x) && isfinite(d.y) &&
                        isfinite(d.z),
                    "a ray that is not finite");
    }
}

int fuzz_lens(const uint8_t *data, size_t size)
{
    blob_lens_element_t elements[LENS_MAX_ELEMENTS];
    blob_pupil_t pupils[LENS_PUPILS];
    uint32_t count;
    double thickness;
    const double film = 0.0175;
    fuzz_write("fuzz.dat", data, size);
    result_t result = lens_file_read(fuzz_path("fuzz.dat"), elements, &count);
    fuzz_expect(result.code == RESULT_OK ? count > 0 : result.message[0] != '\0',
                "an empty lens, or message");
    if (result.code != RESULT_OK) return 0;
    lens_t lens = {.elements = elements, .count = count};
    if (lens_focus(&lens, 1e-3 * film, 2, &thickness).code != RESULT_OK) return 0;
    fuzz_expect(isfinite(thickness) && thickness > 0, "a lens behind the film");
    elements[count - 1].thickness = (float)thickness;
    lens_find_pupils(&lens, film, pupils);
    for (int i = 0; i < LENS_PUPILS; i += 9) trace_through(&lens, &pupils[i], film * i / LENS_PUPILS);
    return 0;
}
