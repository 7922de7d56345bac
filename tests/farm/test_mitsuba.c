/* Scenes of Mitsuba and pbrt scenes of the same content, written by hand from what either program documents:
 * `lightmill compare` finds no difference between their pictures. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#include "common/base.h"

#define SPP "64"

/* ---- a room: textures, plastic, metal, glass, a mask, smooth normals, an area light -------------------- */

static const char roof_obj[] = "v 0 0 0\nv 1 0 1\nv 2 0 0\nv 0 1 0\nv 1 1 1\nv 2 1 0\nf 1 2 5 4\nf 2 3 6 5\n";

static const char room_xml[] =
    "<scene version='0.6.0'>"
    "<integrator type='bdpt'><integer name='maxDepth' value='6'/></integrator>"
    "<sensor type='perspective'><float name='fov' value='40'/>"
    "<transform name='toWorld'><lookat origin='0.4, 1.2, 5' target='0, 0.8, 0' up='0, 1, 0'/></transform>"
    "<film type='hdrfilm'><integer name='width' value='48'/><integer name='height' value='36'/>"
    "<rfilter type='box'/></film></sensor>"
    "<bsdf type='twosided' id='floor'><bsdf type='diffuse'><texture type='checkerboard' name='reflectance'>"
    "<rgb name='color0' value='0.6, 0.5, 0.4'/><rgb name='color1' value='0.2, 0.3, 0.4'/>"
    "<float name='uscale' value='4'/><float name='vscale' value='3'/></texture></bsdf></bsdf>"
    "<shape type='rectangle'><ref id='floor'/><transform name='toWorld'><rotate x='1' angle='-90'/>"
    "<scale value='3'/></transform></shape>"
    "<shape type='rectangle'><transform name='toWorld'><rotate x='1' angle='90'/><scale value='0.7'/>"
    "<translate y='3'/></transform><emitter type='area'><rgb name='radiance' value='8, 8, "
    "7'/></emitter></shape>"
    "<shape type='sphere'><point name='center' x='-0.8' y='0.5' z='0'/><float name='radius' value='0.5'/>"
    "<bsdf type='plastic'><float name='intIOR' value='1.5'/><float name='extIOR' value='1'/>"
    "<rgb name='diffuseReflectance' value='0.2, 0.4, 0.6'/></bsdf></shape>"
    "<shape type='cube'><transform name='toWorld'><scale value='0.4'/><rotate y='1' angle='30'/>"
    "<translate x='0.8' y='0.4' z='0.5'/></transform><bsdf type='roughconductor'>"
    "<string name='distribution' value='ggx'/><float name='alpha' value='0.3'/><float name='extEta' "
    "value='1'/>"
    "<rgb name='eta' value='0.2, 0.9, 1.1'/><rgb name='k' value='3.9, 2.4, 2.2'/></bsdf></shape>"
    "<shape type='sphere'><point name='center' x='0' y='0.3' z='1.2'/><float name='radius' value='0.3'/>"
    "<bsdf type='dielectric'><float name='intIOR' value='1.5'/><float name='extIOR' "
    "value='1'/></bsdf></shape>"
    "<shape type='rectangle'><transform name='toWorld'><scale value='0.5'/><translate x='-1.2' y='1.5' "
    "z='-1'/>"
    "</transform><bsdf type='mask'><float name='opacity' value='0.5'/><bsdf type='diffuse'/></bsdf></shape>"
    "<shape type='obj'><string name='filename' value='roof.obj'/><transform name='toWorld'>"
    "<rotate x='1' angle='-90'/><translate x='-0.2' y='0.9' z='-1'/></transform>"
    "<bsdf type='diffuse'><rgb name='reflectance' value='0.7, 0.2, 0.1'/></bsdf></shape>"
    "</scene>";

/* What Mitsuba's linear plastic reflects is that of a base r / (1 - F + r F), F = 0.59635 for index 1.5. */
static const char room_pbrt[] =
    "Integrator \"bdpt\" \"integer maxdepth\" 5\n"
    "PixelFilter \"box\" \"float xradius\" 0.5 \"float yradius\" 0.5\n"
    "Film \"rgb\" \"integer xresolution\" 48 \"integer yresolution\" 36\n"
    "Scale -1 1 1\nLookAt 0.4 1.2 5  0 0.8 0  0 1 0\n"
    "Camera \"perspective\" \"float fov\" 30.5369432627651\n"
    "WorldBegin\n"
    "Texture \"checks\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [0.6 0.5 0.4] \"rgb tex2\" [0.2 0.3 0.4] "
    "\"float uscale\" 8 \"float vscale\" 6\n"
    "Material \"diffuse\" \"texture reflectance\" \"checks\"\n"
    "Shape \"trianglemesh\" \"point3 P\" [-3 0 3  3 0 3  3 0 -3  -3 0 -3] \"point2 uv\" [0 0 1 0 1 1 0 1] "
    "\"integer indices\" [0 1 2 0 2 3]\n"
    "AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [0 0 0]\n"
    "AreaLightSource \"diffuse\" \"rgb L\" [8 8 7]\n"
    "Shape \"trianglemesh\" \"point3 P\" [-0.7 3 -0.7  0.7 3 -0.7  0.7 3 0.7  -0.7 3 0.7] "
    "\"integer indices\" [0 1 2 0 2 3]\nAttributeEnd\n"
    "AttributeBegin\nTranslate -0.8 0.5 0\nMaterial \"coateddiffuse\" \"float eta\" 1.5 \"float roughness\" "
    "0 "
    "\"float thickness\" 0 \"rgb reflectance\" [0.38246520 0.62286615 0.78795822]\n"
    "Shape \"sphere\" \"float radius\" 0.5\nAttributeEnd\n"
    "AttributeBegin\nTranslate 0.8 0.4 0.5\nRotate 30 0 1 0\nScale 0.4 0.4 0.4\n"
    "Material \"conductor\" \"rgb eta\" [0.2 0.9 1.1] \"rgb k\" [3.9 2.4 2.2] \"float roughness\" 0.3 "
    "\"bool remaproughness\" false\n"
    "Shape \"trianglemesh\" \"point3 P\" [-1 -1 -1  1 -1 -1  1 1 -1  -1 1 -1  -1 -1 1  1 -1 1  1 1 1  -1 1 "
    "1] "
    "\"integer indices\" [0 2 1 0 3 2  4 5 6 4 6 7  0 1 5 0 5 4  2 3 7 2 7 6  1 2 6 1 6 5  3 0 4 3 4 7]\n"
    "AttributeEnd\n"
    "AttributeBegin\nTranslate 0 0.3 1.2\nMaterial \"dielectric\" \"float eta\" 1.5\n"
    "Shape \"sphere\" \"float radius\" 0.3\nAttributeEnd\n"
    "AttributeBegin\nTranslate -1.2 1.5 -1\nScale 0.5 0.5 0.5\nMaterial \"diffuse\" \"rgb reflectance\" [0.5 "
    "0.5 0.5]\n"
    "Shape \"trianglemesh\" \"float alpha\" 0.5 \"point3 P\" [-1 -1 0  1 -1 0  1 1 0  -1 1 0] "
    "\"integer indices\" [0 1 2 0 2 3]\nAttributeEnd\n"
    "AttributeBegin\nTranslate -0.2 0.9 -1\nRotate -90 1 0 0\n"
    "Material \"diffuse\" \"rgb reflectance\" [0.7 0.2 0.1]\n"
    "Shape \"trianglemesh\" \"point3 P\" [0 0 0  1 0 1  2 0 0  0 1 0  1 1 1  2 1 0] "
    "\"normal N\" [-0.70710678 0 0.70710678  0 0 1  0.70710678 0 0.70710678 "
    "-0.70710678 0 0.70710678  0 0 1  0.70710678 0 0.70710678] "
    "\"integer indices\" [0 1 4 0 4 3 1 2 5 1 5 4]\nAttributeEnd\n";

/* ---- a garden: an environment, a thin lens, instances, a blend, Oren-Nayar, a point light -------------- */

static const char garden_xml[] =
    "<scene version='0.6.0'>"
    "<integrator type='bdpt'><integer name='maxDepth' value='5'/></integrator>"
    "<sensor type='thinlens'><float name='fov' value='35'/><string name='fovAxis' value='y'/>"
    "<float name='apertureRadius' value='0.1'/><float name='focusDistance' value='4.5'/>"
    "<transform name='toWorld'><lookat origin='1, 2, 5' target='0, 0.5, 0' up='0, 1, 0'/></transform>"
    "<film type='hdrfilm'><integer name='width' value='48'/><integer name='height' value='36'/>"
    "<rfilter type='tent'/></film></sensor>"
    "<emitter type='envmap'><string name='filename' value='sky.exr'/><float name='scale' value='0.5'/>"
    "<transform name='toWorld'><rotate y='1' angle='40'/></transform></emitter>"
    "<emitter type='point'><point name='position' x='1' y='3' z='2'/><rgb name='intensity' value='9, 6, 3'/>"
    "</emitter>"
    "<shape type='disk'><transform name='toWorld'><rotate x='1' angle='-90'/><scale value='4'/></transform>"
    "<bsdf type='roughdiffuse'><rgb name='reflectance' value='0.5, 0.6, 0.3'/><float name='alpha' "
    "value='0.3'/>"
    "</bsdf></shape>"
    "<shape type='cylinder'><point name='p0' x='-1.5' y='0' z='-1'/><point name='p1' x='-1.5' y='2' z='-1'/>"
    "<float name='radius' value='0.3'/><bsdf type='twosided'><bsdf type='diffuse'/></bsdf></shape>"
    "<shape type='shapegroup' id='thing'>"
    "<shape type='sphere'><point name='center' x='0' y='0.5' z='0'/><float name='radius' value='0.5'/>"
    "<bsdf type='blendbsdf'><float name='weight' value='0.3'/>"
    "<bsdf type='diffuse'><rgb name='reflectance' value='0.8, 0.2, 0.2'/></bsdf>"
    "<bsdf type='conductor'><string name='material' value='none'/></bsdf></bsdf></shape>"
    "<shape type='cube'><transform name='toWorld'><scale value='0.2'/><translate y='1.2'/></transform>"
    "<bsdf type='difftrans'><rgb name='transmittance' value='0.2, 0.5, 0.6'/></bsdf></shape></shape>"
    "<shape type='instance'><ref id='thing'/></shape>"
    "<shape type='instance'><ref id='thing'/><transform name='toWorld'><rotate y='1' angle='20'/>"
    "<scale x='1' y='0.6' z='1'/><translate x='1.2' z='0.8'/></transform></shape>"
    "</scene>";

/* sigma: 0.3 / sqrt(2) radians. The light's columns run from +x towards +y about z; in the scene they run
 * from -z towards +x about y, turned by 40 degrees. pbrt-v3's translucent adds gloss, so Ks is 0. */
static const char garden_pbrt[] =
    "Integrator \"bdpt\" \"integer maxdepth\" 4\n"
    "PixelFilter \"triangle\" \"float xwidth\" 1 \"float ywidth\" 1\n"
    "Film \"image\" \"integer xresolution\" 48 \"integer yresolution\" 36\n"
    "Scale -1 1 1\nLookAt 1 2 5  0 0.5 0  0 1 0\n"
    "Camera \"perspective\" \"float fov\" 35 \"float lensradius\" 0.1 \"float focaldistance\" 4.5\n"
    "WorldBegin\n"
    "AttributeBegin\nRotate 40 0 1 0\nConcatTransform [0 0 -1 0  1 0 0 0  0 1 0 0  0 0 0 1]\n"
    "LightSource \"infinite\" \"string mapname\" \"sky.exr\" \"rgb L\" [0.5 0.5 0.5]\nAttributeEnd\n"
    "LightSource \"point\" \"rgb I\" [9 6 3] \"point from\" [1 3 2]\n"
    "AttributeBegin\nScale 4 4 4\nRotate -90 1 0 0\n"
    "Material \"matte\" \"rgb Kd\" [0.5 0.6 0.3] \"float sigma\" 12.15423\nShape \"disk\" \"float radius\" "
    "1\n"
    "AttributeEnd\n"
    "AttributeBegin\nTranslate -1.5 0 -1\nRotate -90 1 0 0\nMaterial \"matte\" \"rgb Kd\" [0.5 0.5 0.5]\n"
    "Shape \"cylinder\" \"float radius\" 0.3 \"float zmin\" 0 \"float zmax\" 2\nAttributeEnd\n"
    "ObjectBegin \"thing\"\n"
    "MakeNamedMaterial \"red\" \"string type\" \"matte\" \"rgb Kd\" [0.8 0.2 0.2]\n"
    "MakeNamedMaterial \"chrome\" \"string type\" \"mirror\" \"rgb Kr\" [1 1 1]\n"
    "AttributeBegin\nTranslate 0 0.5 0\n"
    "Material \"mix\" \"string namedmaterial1\" \"red\" \"string namedmaterial2\" \"chrome\" "
    "\"rgb amount\" [0.7 0.7 0.7]\nShape \"sphere\" \"float radius\" 0.5\nAttributeEnd\n"
    "AttributeBegin\nTranslate 0 1.2 0\nScale 0.2 0.2 0.2\n"
    "Material \"translucent\" \"rgb Kd\" [0.2 0.5 0.6] \"rgb Ks\" [0 0 0] \"rgb reflect\" [0 0 0] "
    "\"rgb transmit\" [1 1 1]\n"
    "Shape \"trianglemesh\" \"point P\" [-1 -1 -1  1 -1 -1  1 1 -1  -1 1 -1  -1 -1 1  1 -1 1  1 1 1  -1 1 1] "
    "\"integer indices\" [0 2 1 0 3 2  4 5 6 4 6 7  0 1 5 0 5 4  2 3 7 2 7 6  1 2 6 1 6 5  3 0 4 3 4 7]\n"
    "AttributeEnd\nObjectEnd\n"
    "ObjectInstance \"thing\"\n"
    "AttributeBegin\nTranslate 1.2 0 0.8\nScale 1 0.6 1\nRotate 20 0 1 0\nObjectInstance "
    "\"thing\"\nAttributeEnd\n"
    "WorldEnd\n";

/* ---- comparing ----------------------------------------------------------------------------------------- */

static void write_file(const rig_t *rig, const char *name, const void *data, size_t size)
{
    char *path = scratch_path(rig->folder, name);
    scratch_write(path, data, size);
    free(path);
}

/* Renders the text as a scene, strictly, and returns the path of its image. */
static char *render(rig_t *rig, const char *name, const char *text, const char *seed)
{
    char *scene = scratch_path(rig->folder, name), *image = mem_printf("%s.exr", scene);
    scratch_write(scene, text, strlen(text));
    assert_int_equal(rig_run(rig, (const char *[]){"render", scene, "--spp", SPP, "--seed", seed, "--quiet",
                                                   "-o", image, NULL}),
                     0);
    free(scene);
    return image;
}

/* There are 24 blocks, whose channels go together: the rms of their z scatters by 0.15 about 1, and which it
 * is depends on the machine's bits. */
static int compare(rig_t *rig, const char *image, const char *reference)
{
    return rig_run(rig, (const char *[]){"compare", image, reference, "--max-rms", "1.7", NULL});
}

/* Both agree, and the comparison is sharp enough to see `changed`, a text of the first, become `other`. */
static void expect_agreement(rig_t *rig, const char *xml, const char *pbrt, const char *changed,
                             const char *other)
{
    char *mitsuba = render(rig, "scene.xml", xml, "1"), *reference = render(rig, "scene.pbrt", pbrt, "2");
    assert_int_equal(compare(rig, mitsuba, reference), 0);
    const char *at = strstr(xml, changed);
    assert_non_null(at);
    char *wrong = mem_printf("%.*s%s%s", (int)(at - xml), xml, other, at + strlen(changed));
    char *second = render(rig, "wrong.xml", wrong, "1");
    assert_int_equal(compare(rig, second, reference), 8);
    free(wrong);
    free(second);
    free(mitsuba);
    free(reference);
}

static void a_room_of_mitsubas_is_a_room_of_pbrts(void **state)
{
    rig_t *rig = *state;
    write_file(rig, "roof.obj", roof_obj, sizeof roof_obj - 1);
    expect_agreement(rig, room_xml, room_pbrt, "value='8, 8, 7'", "value='8.5, 8.5, 7'");
}

static void a_garden_of_mitsubas_is_a_garden_of_pbrts(void **state)
{
    rig_t *rig = *state;
    size_t size;
    uint8_t *sky = scratch_read("tests/fuzz/assets/sky.exr", &size);
    write_file(rig, "sky.exr", sky, size);
    free(sky);
    expect_agreement(rig, garden_xml, garden_pbrt, "<rotate y='1' angle='40'/>",
                     "<rotate y='1' angle='-40'/>");
}

#define TEST(function) cmocka_unit_test_setup_teardown(function, rig_set_up, rig_tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(a_room_of_mitsubas_is_a_room_of_pbrts),
                                       TEST(a_garden_of_mitsubas_is_a_garden_of_pbrts)};
    return cmocka_run_group_tests_name("scenes of Mitsuba beside scenes of pbrt", tests, NULL, NULL);
}
