/* lens_file: see lens_file.h. */
#include "client/import/files/lens_file.h"

#include "client/import/files/number.h"

#include <math.h>
#include <stdlib.h>

enum { LARGEST_FILE = 1 << 20, COLUMNS = 4 };
static const double largest = 1e6, metres = 1e-3;

typedef struct {
    const char *at, *end;
    position_t place; /* of `at`, without a column */
} reader_t;

/* Goes to the next number; false at the end. */
static bool find_number(reader_t *r)
{
    r->at = number_find(r->at, r->end, &r->place.line);
    return r->at != NULL;
}

static result_t read_number(reader_t *r, double *number)
{
    const char *behind = number_parse_alone(r->at, r->end, number);
    if (!behind)
        return error_at(r->place,
                        "expected a number: a lens file has rows of radius of curvature, thickness, "
                        "index of refraction and aperture diameter, and comments behind '#'");
    if (!(fabs(*number) <= largest))
        return error_at(r->place, "the number %g is beyond the limit of %g", *number, largest);
    r->at = behind;
    return result_ok();
}

/* A row, whose first number the reader stands at. */
static result_t read_row(reader_t *r, double row[COLUMNS])
{
    uint32_t line = r->place.line;
    for (int i = 0; i < COLUMNS; ++i) {
        if (i > 0 && !find_number(r))
            return error_at((position_t){r->place.path, line, 0},
                            "a lens's surface takes 4 numbers, found %d at the end of the file", i);
        TRY(read_number(r, &row[i]));
    }
    return result_ok();
}

static result_t make_element(const double row[COLUMNS], position_t at, blob_lens_element_t *element)
{
    if (!(row[3] > 0)) return error_at(at, "an aperture's diameter is %g mm, but must be positive", row[3]);
    if (row[2] != 0 && !(row[2] >= 0.01 && row[2] <= 100))
        return error_at(at, "an index of refraction is %g, but must be from 0.01 to 100, or 0 for air",
                        row[2]);
    *element = (blob_lens_element_t){.curvature_radius = (float)(row[0] * metres),
                                     .thickness = (float)(row[1] * metres),
                                     .eta = row[2] == 0 ? 1 : (float)row[2],
                                     .aperture_radius = (float)(row[3] * metres / 2)};
    if (element->aperture_radius > 0) return result_ok();
    return error_at(at, "an aperture's diameter is %g mm, which is too small", row[3]);
}

static result_t read_elements(reader_t *r, blob_lens_element_t *elements, uint32_t *count)
{
    position_t before = r->place;
    for (*count = 0; find_number(r); ++*count) {
        double row[COLUMNS];
        position_t at = r->place;
        if (*count == LENS_MAX_ELEMENTS)
            return error_at(at, "a lens has at most %d surfaces", LENS_MAX_ELEMENTS);
        if (*count > 0 && elements[*count - 1].thickness < 0)
            return error_at(before,
                            "the next surface must not lie before this one: the thickness is negative");
        TRY(read_row(r, row));
        TRY(make_element(row, at, &elements[*count]));
        before = at;
    }
    if (*count == 0) return error_at((position_t){.path = r->place.path}, "the lens file has no surfaces");
    return result_ok();
}

result_t lens_file_read(const char *path, blob_lens_element_t elements[LENS_MAX_ELEMENTS], uint32_t *count)
{
    uint8_t *data;
    size_t size;
    *count = 0;
    TRY(file_read(path, LARGEST_FILE, &data, &size));
    const char *text = (const char *)data;
    reader_t r = {.at = text, .end = text + size, .place = {path, 1, 0}};
    result_t result = read_elements(&r, elements, count);
    free(data);
    return result;
}
