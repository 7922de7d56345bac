/* cube: see cube.h. */
#include "client/import/environment/cube.h"

#include <stdlib.h>

enum { LEAST_ROWS = 128, MOST_ROWS = 2048 };
static const double pi = 3.14159265358979323846;

void cube_free(cube_t *cube)
{
    for (int i = 0; i < CUBE_FACES; ++i) free(cube->faces[i]);
}

/* ---- faces --------------------------------------------------------------------------------------------- */

static double value_at(const texture_image_t *image, size_t index)
{
    return image->type == TEXELS_U8 ? image->bytes[index] / 255.0 : fmax((double)image->floats[index], 0);
}

/* The colour of a pixel. Where a format whose colours are encoded has an alpha, that divides them: RGBD, of
 * which the alpha of 0 is not, and counts as the least above it. */
static vec3_t colour_at(const texture_image_t *image, size_t pixel)
{
    size_t channels = image->channels, first = pixel * channels;
    double rgb[3], divisor = 1;
    if (image->encoded && channels % 2 == 0) divisor = fmax(value_at(image, first + channels - 1), 1 / 255.0);
    for (size_t i = 0; i < 3; ++i) {
        double value = value_at(image, first + (channels < 3 ? 0 : i));
        rgb[i] = (image->encoded ? scene_decode_srgb(value) : value) / divisor;
    }
    return vec3((float)rgb[0], (float)rgb[1], (float)rgb[2]);
}

bool cube_set_face(cube_t *cube, int face, const texture_image_t *image)
{
    if (image->width != image->height || (face > 0 && image->width != cube->side)) return false;
    size_t pixels = (size_t)image->width * image->height;
    cube->side = image->width;
    cube->faces[face] = mem_alloc(pixels * sizeof(vec3_t));
    for (size_t i = 0; i < pixels; ++i) cube->faces[face][i] = colour_at(image, i);
    return true;
}

/* ---- laying out ---------------------------------------------------------------------------------------- */

static vec3_t texel(const cube_t *cube, int face, double s, double t)
{
    double most = cube->side - 1.0;
    size_t column = (size_t)fmin(fmax(s, 0), most), row = (size_t)fmin(fmax(t, 0), most);
    return cube->faces[face][row * cube->side + column];
}

/* Between the four texels about a place on a face, from 0 to 1 across and down. */
static vec3_t look_up(const cube_t *cube, int face, double across, double down)
{
    double x = across * cube->side - 0.5, y = down * cube->side - 0.5, s = floor(x), t = floor(y);
    float u = (float)(x - s), v = (float)(y - t);
    vec3_t upper = v_mad(v_scale(texel(cube, face, s, t), 1 - u), u, texel(cube, face, s + 1, t));
    vec3_t lower = v_mad(v_scale(texel(cube, face, s, t + 1), 1 - u), u, texel(cube, face, s + 1, t + 1));
    return v_mad(v_scale(upper, 1 - v), v, lower);
}

/* The table of cube maps in OpenGL's specification (4.6, section 8.13), whose first row is the upper one. */
static vec3_t cube_radiance(const cube_t *cube, const double d[3])
{
    double size[3] = {fabs(d[0]), fabs(d[1]), fabs(d[2])};
    int axis = size[0] >= size[1] && size[0] >= size[2] ? 0 : size[1] >= size[2] ? 1 : 2;
    bool negative = d[axis] < 0;
    double across = d[0], down = -d[1];
    if (axis == 0) across = negative ? d[2] : -d[2];
    if (axis == 1) down = negative ? -d[2] : d[2];
    if (axis == 2 && negative) across = -d[0];
    return look_up(cube, 2 * axis + negative, (across / size[axis] + 1) / 2, (down / size[axis] + 1) / 2);
}

/* The mean of four directions within a pixel of the layout LIGHT_LATLONG_Y. */
static vec3_t pixel_radiance(const cube_t *cube, uint32_t rows, uint32_t x, uint32_t y)
{
    vec3_t sum = vec3(0, 0, 0);
    for (int i = 0; i < 4; ++i) {
        double theta = (y + 0.25 + 0.5 * (i / 2)) * pi / rows, phi = (x + 0.25 + 0.5 * (i % 2)) * pi / rows;
        double d[3] = {sin(theta) * cos(phi), cos(theta), sin(theta) * sin(phi)};
        sum = v_mad(sum, 0.25f, cube_radiance(cube, d));
    }
    return sum;
}

/* As fine as the middle of the cube's faces, within limits. */
static uint32_t rows_of(const cube_t *cube)
{
    if (cube->side >= MOST_ROWS / 2) return MOST_ROWS;
    return cube->side <= LEAST_ROWS / 2 ? LEAST_ROWS : 2 * cube->side;
}

blob_ref_t cube_add_image(scene_builder_t *scene, const cube_t *cube)
{
    uint32_t rows = rows_of(cube), columns = 2 * rows;
    vec3_t *pixels = mem_alloc((size_t)rows * columns * sizeof *pixels);
    for (uint32_t y = 0; y < rows; ++y)
        for (uint32_t x = 0; x < columns; ++x) pixels[y * columns + x] = pixel_radiance(cube, rows, x, y);
    blob_ref_t image = scene_float_image(scene, &pixels[0].x, columns, rows, 3);
    free(pixels);
    return image;
}
