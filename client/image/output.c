/* output: see output.h. A master hands out images as finished EXR files, so the EXR is written as it came;
 * a PNG is made from it. */
#include "client/image/output.h"

#include "common/atomic_file.h"
#include "common/film/picture.h"
#include "common/image/image.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

static const option_t rows[] = {
    OPTION(output_t, path, "output", "FILE", "where the image goes: .exr, or .png for a PNG alone",
           .letter = 'o'),
    OPTION(output_t, png, "png", "FILE", "write a PNG as well"),
    OPTION(output_t, exposure, "exposure", "STOPS", "brighten (or darken) PNGs", OPTION_RANGE(-50, 50)),
    OPTION(output_t, half, "half", NULL, "half floats in the EXR"),
};
const option_group_t output_options = OPTION_GROUP("The image", rows);

static bool has_extension(const char *path, const char *extension)
{
    size_t length = strlen(path), tail = strlen(extension);
    return length > tail && strcasecmp(path + length - tail, extension) == 0;
}

bool output_is_png(const char *path)
{
    return has_extension(path, ".png");
}

void output_name(output_t *output, const char *scene, bool strategies)
{
    output->own_path = mem_printf(strategies ? "%s-strategies.exr" : "%s.exr", scene);
    if (output->path == NULL) output->path = output->own_path;
    output->own_png = picture_png_path(output->path);
    if (strategies && output->png == NULL && !output_is_png(output->path)) output->png = output->own_png;
}

/* "a.exr" at 16 is "a-0016.exr": with four digits at least, so that files sort by samples. */
static char *path_at(const char *path, uint32_t spp)
{
    const char *slash = strrchr(path, '/'), *dot = strrchr(slash != NULL ? slash : path, '.');
    size_t stem = dot != NULL ? (size_t)(dot - path) : strlen(path);
    return mem_printf("%.*s-%04u%s", (int)stem, path, spp, path + stem);
}

output_t output_at(const output_t *output, uint32_t spp)
{
    output_t at = *output;
    at.path = at.own_path = path_at(output->path, spp);
    at.own_png = NULL;
    if (output->png != NULL) at.png = at.own_png = path_at(output->png, spp);
    return at;
}

result_t output_check_saves(const output_t *output, const save_at_t *save_at)
{
    result_t result = result_ok();
    for (uint32_t i = 0; i < save_at->count && result.code == RESULT_OK; i++) {
        output_t at = output_at(output, save_at->spp[i]);
        result = output_check(&at);
        output_free(&at);
    }
    return result;
}

void output_free(output_t *output)
{
    free(output->own_path);
    free(output->own_png);
    *output = (output_t){0};
}

/* Opens the temporary that the writer will use and removes it again: nothing else knows as well whether the
 * disk, the mount and the permissions allow it. */
result_t output_writable(const char *path)
{
    struct stat status;
    if (stat(path, &status) == 0 && S_ISDIR(status.st_mode))
        return result_fail(RESULT_USAGE, "%.300s is a directory, not a file to write to", path);
    atomic_file_t file;
    TRY(atomic_file_open(&file, path));
    atomic_file_abort(&file);
    return result_ok();
}

result_t output_check(const output_t *output)
{
    if (output->path && !has_extension(output->path, ".exr") && !output_is_png(output->path))
        return result_fail(RESULT_USAGE, "the output '%.200s' must end in .exr or .png", output->path);
    if (output->path && output->halves && output_is_png(output->path))
        return result_fail(RESULT_USAGE,
                           "--halves are layers of an EXR: -o must end in .exr (--png adds a PNG)");
    if (output->png && !output_is_png(output->png))
        return result_fail(RESULT_USAGE, "the PNG '%.200s' must end in .png", output->png);
    if (output->path) TRY(output_writable(output->path));
    if (output->png) TRY(output_writable(output->png));
    return result_ok();
}

/* Estimated relative error of an image of ours (film_noise); negative when it is not known. */
static double relative_noise(const image_t *image)
{
    const image_attribute_t *error = image_attribute(image, "lightmill.error");
    return error != NULL && error->kind == ATTRIBUTE_FLOAT ? (double)error->real : -1;
}

result_t output_write_pngs(const output_t *output, const image_t *image)
{
    float exposure = (float)output->exposure;
    if (output_is_png(output->path)) TRY(image_write_png(output->path, image, exposure));
    return output->png != NULL ? image_write_png(output->png, image, exposure) : result_ok();
}

result_t output_write(const output_t *output, const uint8_t *exr, size_t size, double *noise)
{
    bool png_alone = output_is_png(output->path);
    image_t image;
    *noise = -1;
    if (!png_alone) TRY(file_write_atomic(output->path, exr, size));
    result_t result = image_decode_exr("the image", exr, size, &image);
    /* An EXR that is too large to be decoded here is whole all the same. */
    if (result.code != RESULT_OK) return png_alone || output->png ? result : result_ok();
    *noise = relative_noise(&image);
    result = output_write_pngs(output, &image);
    image_free(&image);
    return result;
}
