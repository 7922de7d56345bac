/* mix: `lightmill mix`, the command around mixture.h: options and files. */
#include "client/commands/commands.h"
#include "client/image/mixture.h"
#include "client/image/output.h"

typedef struct {
    output_t output;
    const char *solo;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, solo, "solo", "GROUP", "only this group; the others are put out"),
};
static const option_group_t mix_options = OPTION_GROUP(NULL, rows);

static result_t write_files(const output_t *output, const image_t *image)
{
    if (!output_is_png(output->path)) TRY(image_write_exr(output->path, image));
    return output_write_pngs(output, image);
}

static result_t mix(const call_t *call, const image_t *image)
{
    const values_t *values = call->values;
    mixture_t mixture;
    TRY(mixture_of(image, call->arguments[0], &mixture));
    for (int i = 1; i < call->count; i++) TRY(mixture_set(&mixture, call->arguments[i]));
    if (values->solo != NULL) TRY(mixture_solo(&mixture, values->solo));
    image_t mixed;
    result_t result = mixture_make(&mixture, values->output.half, &mixed);
    if (result.code == RESULT_OK) result = write_files(&values->output, &mixed);
    image_free(&mixed);
    return result;
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    if (values->output.path == NULL)
        return result_fail(RESULT_USAGE, "say where the mixed image goes: -o FILE.exr or -o FILE.png");
    TRY(output_check(&values->output));
    image_t image;
    TRY(image_read_exr(call->arguments[0], &image));
    result_t result = mix(call, &image);
    image_free(&image);
    return result;
}

const command_t mix_command = {
    .name = "lightmill mix",
    .arguments = "IMAGE [GROUP=FACTOR...]",
    .summary = "make lights brighter, darker or coloured in an image with light groups",
    .about = "Makes the picture of IMAGE anew from its light groups, each times a factor, or times a colour: "
             "GROUP=R,G,B. Groups that are not named stay as they are. IMAGE is an OpenEXR file of a render "
             "with --light-groups.\n\n"
             "The new image has R G B, the layers eye and light, and those that no light changes (albedo, "
             "depth, ...). With every factor 1 its picture is that of IMAGE.",
    .after = "Examples:\n"
             "lightmill mix a.exr key=2 sky=0.5 -o b.exr\n"
             "lightmill mix a.exr lamp=1,0.7,0.4 -o b.png --exposure 1\n"
             "lightmill mix a.exr --solo lamp -o lamp.exr",
    .groups = {{&mix_options, 0}, {&output_options, offsetof(values_t, output)}},
    .size = sizeof(values_t),
    .run = run};
