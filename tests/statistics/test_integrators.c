/* The integrators against one another, on small scenes of what the reference images (test_references.c) do
 * not show: they share cameras, lights and shapes, but each asks other questions of them. Scenes are pbrt
 * text, so that the importer is tested as well. */
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 32 };

static char *folder;
/* From the command line: the one scene that is to be rendered; NULL for all. */
static const char *only_scene;

/* ---- scenes -------------------------------------------------------------------------------------------- */

#define LOOK "LookAt 0 1.6 -5  0 1 0  0 1 0\n"
#define PERSPECTIVE LOOK "Camera \"perspective\" \"float fov\" [40]\n"
#define FILM3 "Film \"image\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
#define FILM4 "Film \"rgb\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
#define BOX "PixelFilter \"box\" \"float xwidth\" [0.5] \"float ywidth\" [0.5]\n"
#define BOX4 "PixelFilter \"box\" \"float xradius\" [0.5] \"float yradius\" [0.5]\n"
#define DEPTH5 "Sampler \"sobol\"\nIntegrator \"bdpt\" \"integer maxdepth\" [5]\n"
#define HEAD3 PERSPECTIVE FILM3 BOX DEPTH5 "WorldBegin\n"
#define HEAD4 PERSPECTIVE FILM4 BOX4 DEPTH5 "WorldBegin\n"
#define END3 "WorldEnd\n"

#define QUAD(p) "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point P\" [" p "]\n"
#define QUAD_UV(p, more)                                                                                     \
    "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"float uv\" [0 0 1 0 1 1 0 1] "               \
    "\"point P\" [" p "] " more "\n"
#define QUAD_UV4(p, more)                                                                                    \
    "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point2 uv\" [0 0 1 0 1 1 0 1] "              \
    "\"point3 P\" [" p "] " more "\n"
#define FLOOR "-2 0 -2  2 0 -2  2 0 2  -2 0 2"
#define STAGE(kind, colour)                                                                                  \
    "Material \"" kind "\" \"rgb " colour "\" [0.6 0.6 0.55]\n" QUAD(FLOOR)                                  \
        QUAD("-2 0 2  2 0 2  2 3 2  -2 3 2") "Material \"" kind "\" \"rgb " colour                           \
                                             "\" [0.7 0.2 0.2]\n" QUAD("-2 0 -2  -2 0 2  -2 3 2  -2 3 -2")
#define BALL "AttributeBegin\nTranslate 0.7 0.5 0.2\nShape \"sphere\" \"float radius\" [0.5]\nAttributeEnd\n"
#define PLACE3 STAGE("matte", "Kd") BALL
#define PLACE4 STAGE("diffuse", "reflectance") BALL
#define LAMP(radiance)                                                                                       \
    "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [" radiance                                       \
    "]\n" QUAD("-0.5 2.9 -0.5  0.5 2.9 -0.5  0.5 2.9 0.5  -0.5 2.9 0.5") "AttributeEnd\n"
/* In reach of the ball. */
#define CUBE                                                                                                 \
    "Shape \"trianglemesh\" \"integer indices\" [0 2 1 1 2 3 4 5 6 5 7 6 0 1 4 1 5 4 2 6 3 3 6 7 0 4 2 2 4 " \
    "6 1 3 5 3 7 5] \"point P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1]\n"

enum { BDPT = 1, PATH = 2, LIGHT = 4, ALL = 7 };

/* A scene that the integrators must agree on. */
typedef struct {
    const char *name, *text;
    int integrators;
} case_t;

static const case_t cases[] = {
    /* cameras */
    {"orthographic",
     LOOK "Camera \"orthographic\" \"float screenwindow\" [-1.8 1.8 -1 2.6]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"orthographic-sky",
     LOOK "Camera \"orthographic\" \"float screenwindow\" [-2.4 2.4 -1.4 3.4]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 "LightSource \"infinite\" \"rgb L\" [1 0.8 0.6]\n" END3,
     ALL},
    {"orthographic-scaled",
     LOOK "Scale 2 2 2\nCamera \"orthographic\" \"float screenwindow\" [-2.4 2.4 -1.4 3.4]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"environment",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"environment\"\n" FILM3 BOX DEPTH5
     "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"environment-gaussian",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"environment\"\n" FILM3
     "PixelFilter \"gaussian\" \"float xwidth\" [3] \"float ywidth\" [3] \"float alpha\" [0.3]\n" DEPTH5
     "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"equal-area",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"spherical\"\n" FILM4 BOX4 DEPTH5
     "WorldBegin\n" PLACE4 LAMP("12 11 9"),
     ALL},
    {"equal-area-gaussian",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"spherical\"\n" FILM4
     "PixelFilter \"gaussian\" \"float xradius\" [3] \"float yradius\" [3] \"float sigma\" [1]\n" DEPTH5
     "WorldBegin\n" PLACE4 LAMP("12 11 9"),
     ALL},
    {"lens",
     LOOK "Camera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.4] \"float focaldistance\" "
          "[4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"lens-scaled",
     LOOK "Scale -2 2 2\nCamera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.4] \"float "
          "focaldistance\" [4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"camera-stretched",
     LOOK "Scale 1 1.7 1.3\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"camera-moves",
     LOOK "ActiveTransform EndTime\nTranslate 0.3 0.1 0.4\nRotate 8 0.2 1 0.4\nActiveTransform All\n"
          "Camera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.1] \"float focaldistance\" "
          "[4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"instance-moves",
     HEAD3 PLACE3
     "ObjectBegin \"thing\"\nTranslate 0 0 0\nScale 0.3 0.5 0.3\n" CUBE
     "Translate 0 1.4 0\nShape \"sphere\" \"float phimax\" [250]\nObjectEnd\n"
     "AttributeBegin\nTranslate -0.8 0.6 0\nActiveTransform EndTime\nTranslate 0.5 0.2 "
     "-0.4\nRotate 50 1 1 0\nScale 1 1 1.5\nActiveTransform All\nObjectInstance \"thing\"\nAttributeEnd\n"
     "AttributeBegin\nTranslate 0.8 1.5 0\nScale -0.7 0.7 0.7\nActiveTransform EndTime\nTranslate "
     "0.5 0.2 -0.4\nRotate 120 0 1 0.4\nActiveTransform All\nObjectInstance "
     "\"thing\"\nAttributeEnd\n" LAMP("12 11 9") END3,
     ALL},
    /* filters */
    {"mitchell",
     PERSPECTIVE FILM3 "PixelFilter \"mitchell\"\n" DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3, ALL},
    {"sinc", PERSPECTIVE FILM3 "PixelFilter \"sinc\"\n" DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"gaussian",
     PERSPECTIVE FILM3 "PixelFilter \"gaussian\" \"float xwidth\" [2.5] \"float ywidth\" [1.5]\n" DEPTH5
                       "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    /* lights */
    {"disk-light",
     HEAD3 PLACE3 "AttributeBegin\nTranslate -0.4 2.5 0\nRotate 70 1 0 0\nScale 0.8 0.4 1\n"
                  "AreaLightSource \"diffuse\" \"rgb L\" [20 15 12]\nShape \"disk\" \"float radius\" [1] "
                  "\"float innerradius\" [0.4] \"float phimax\" [220]\nAttributeEnd\n" END3,
     ALL},
    {"cylinder-light",
     HEAD3 PLACE3
     "AttributeBegin\nTranslate -0.6 1.6 0\nRotate 30 1 1 0\nScale 0.5 0.2 0.7\nAreaLightSource \"diffuse\" "
     "\"rgb L\" [12 15 9] \"bool twosided\" [\"true\"]\nShape \"cylinder\" \"float radius\" [1] \"float "
     "phimax\" "
     "[200]\nAttributeEnd\n" END3,
     ALL},
    {"sphere-light",
     HEAD3 PLACE3
     "AttributeBegin\nTranslate -0.6 1.6 0\nRotate 30 1 1 0\nScale 0.5 0.2 0.7\nReverseOrientation\n"
     "AreaLightSource \"diffuse\" \"rgb L\" [12 15 9]\nShape \"sphere\" \"float radius\" [1] \"float "
     "phimax\" "
     "[260] \"float zmin\" [-0.3] \"float zmax\" [0.8]\nAttributeEnd\n" END3,
     ALL},
    {"textured-light",
     HEAD4 PLACE4
     "AttributeBegin\nAreaLightSource \"diffuse\" \"string filename\" \"square.pfm\" \"float "
     "scale\" [14] \"bool twosided\" true\n" QUAD_UV4(
         "-0.5 2.4 -0.5  0.5 2.6 -0.5  0.5 2.6 0.5  -0.5 2.4 0.5",
         "") "AttributeEnd\n"
             "AttributeBegin\nTranslate -0.6 1.6 0\nAreaLightSource \"diffuse\" \"string filename\" "
             "\"square.pfm\" \"float scale\" [30]\nShape \"sphere\" \"float radius\" [0.3]\nAttributeEnd\n",
     ALL},
    {"smooth-light", /* vertex normals tell the side */
     HEAD3 PLACE3
     "AttributeBegin\nReverseOrientation\nAreaLightSource \"diffuse\" \"rgb L\" [12 11 10]\nShape "
     "\"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point P\" [-0.5 2.6 -0.5 0.5 2.9 -0.5 0.5 2.6 0.5 "
     "-0.5 "
     "2.5 0.5] \"normal N\" [0 1 0 0.3 1 0 0 1 0.3 0 1 0]\nAttributeEnd\n" END3,
     ALL},
    {"point", HEAD3 PLACE3 "LightSource \"point\" \"rgb I\" [6 7 5] \"point from\" [-0.6 2 -0.5]\n" END3,
     ALL},
    {"spot-v3",
     HEAD3 PLACE3
     "LightSource \"spot\" \"rgb I\" [20 18 19] \"point from\" [-1 2.5 -1.5] \"point to\" [0.4 0.2 "
     "0.2] \"float coneangle\" [35] \"float conedeltaangle\" [20]\n" END3,
     ALL},
    {"spot-v4",
     HEAD4 PLACE4
     "LightSource \"spot\" \"rgb I\" [20 18 19] \"point3 from\" [-1 2.5 -1.5] \"point3 to\" [0.4 "
     "0.2 0.2] \"float coneangle\" [110] \"float conedeltaangle\" [30]\n",
     ALL},
    {"goniometric-v3",
     HEAD3 PLACE3 "AttributeBegin\nTranslate -0.5 1.8 -0.3\nRotate 40 1 0.3 0.2\nLightSource \"goniometric\" "
                  "\"rgb I\" [8 7 9] \"string mapname\" [\"wide.pfm\"]\nAttributeEnd\n" END3,
     ALL},
    {"goniometric-v4",
     HEAD4 PLACE4 "AttributeBegin\nTranslate -0.5 1.8 -0.3\nRotate 40 1 0.3 0.2\nLightSource \"goniometric\" "
                  "\"rgb I\" [8 7 9] \"string filename\" \"square.pfm\"\nAttributeEnd\n",
     ALL},
    {"goniometric-stretched",
     HEAD3 PLACE3 "AttributeBegin\nTranslate -0.5 1.8 -0.3\nRotate 40 1 0.3 0.2\nScale 1 2 0.6\nLightSource "
                  "\"goniometric\" \"rgb I\" [8 7 9] \"string mapname\" [\"wide.pfm\"]\nAttributeEnd\n" END3,
     ALL},
    {"projection-v3",
     HEAD3 PLACE3
     "AttributeBegin\nTranslate -0.5 2.2 -1.5\nRotate 40 1 0.1 0.1\nLightSource \"projection\" "
     "\"rgb I\" [20 18 16] \"float fov\" [60] \"string mapname\" [\"wide.pfm\"]\nAttributeEnd\n" END3,
     ALL},
    {"projection-v4",
     HEAD4 PLACE4 "AttributeBegin\nTranslate -0.5 2.2 -1.5\nRotate 40 1 0.1 0.1\nScale 1 -1.5 1\nLightSource "
                  "\"projection\" \"float scale\" [20] \"float fov\" [80] \"string filename\" "
                  "\"square.pfm\"\nAttributeEnd\n",
     ALL},
    {"distant", HEAD3 PLACE3 "LightSource \"distant\" \"rgb L\" [2 1.8 1.5] \"point from\" [-1 2 -2]\n" END3,
     ALL},
    {"sky-v3",
     HEAD3 PLACE3 "AttributeBegin\nRotate 40 1 0.3 0.2\nLightSource \"infinite\" \"string mapname\" "
                  "[\"wide.pfm\"]\nAttributeEnd\n" END3,
     ALL},
    {"sky-v4",
     HEAD4 PLACE4 "AttributeBegin\nRotate 40 1 0.3 0.2\nLightSource \"infinite\" \"string filename\" "
                  "\"square.pfm\"\nAttributeEnd\n",
     ALL},
    {"sky-stretched",
     HEAD3 PLACE3 "AttributeBegin\nRotate 40 1 0.3 0.2\nScale -1 2.5 0.7\nLightSource \"infinite\" \"string "
                  "mapname\" [\"wide.pfm\"]\nAttributeEnd\n" END3,
     ALL},
    {"several-lights",
     HEAD3 PLACE3 LAMP(
         "5 4 3") "LightSource \"point\" \"rgb I\" [1 2 3] \"point from\" [-0.6 2 -0.5]\n"
                  "LightSource \"infinite\" \"rgb L\" [0.2 0.3 0.4]\n"
                  "LightSource \"infinite\" \"string mapname\" [\"wide.pfm\"] \"rgb L\" [0.2 0.2 0.2]\n"
                  "LightSource \"distant\" \"rgb L\" [0.5 0.1 0.1] \"point from\" [-1 2 -2]\n"
                  "AttributeBegin\nTranslate -0.9 0.7 -0.3\nAreaLightSource \"diffuse\" \"rgb L\" "
                  "[9 3 6]\nShape \"sphere\" \"float radius\" [0.15]\nAttributeEnd\n" END3,
     ALL},
    /* alpha */
    {"alpha-half",
     HEAD4 PLACE4 QUAD_UV4("-1.2 0.4 -0.8  -0.2 0.4 -0.8  0 1.6 -0.2  -1 1.6 -0.2",
                           "\"float alpha\" [0.5]") "AttributeBegin\nTranslate 0.5 1.6 -0.4\nShape "
                                                    "\"sphere\" \"float radius\" [0.4] \"float alpha\" "
                                                    "[0.4]\nAttributeEnd\n" LAMP("12 11 9"),
     ALL},
    {"alpha-cutout",
     HEAD3 "Texture \"squares\" \"float\" \"checkerboard\" \"float uscale\" [4] \"float vscale\" [4] \"float "
           "tex1\" [1] \"float tex2\" [0]\n" PLACE3 QUAD_UV(
               "-1.2 0.4 -0.8  -0.2 0.4 -0.8  0 1.6 -0.2  -1 1.6 -0.2",
               "\"texture alpha\" \"squares\"") "AttributeBegin\nTranslate 0.5 1.6 -0.4\nShape \"sphere\" "
                                                "\"float radius\" [0.4] \"texture "
                                                "alpha\" \"squares\"\nAttributeEnd\n" LAMP("12 11 9") END3,
     ALL},
    {"alpha-emitter",
     HEAD4 "Texture \"squares\" \"float\" \"checkerboard\" \"float uscale\" [3] \"float vscale\" [3] \"float "
           "tex1\" [0.7] \"float tex2\" [0.1]\n" PLACE4
           "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [12 11 10]\n" QUAD_UV4(
               "-0.5 2.4 -0.5  0.5 2.4 -0.5  0.5 2.4 0.5  -0.5 2.4 0.5",
               "\"texture alpha\" \"squares\"") "AttributeEnd\nAttributeBegin\nTranslate -0.6 0.8 "
                                                "0\nAreaLightSource \"diffuse\" \"rgb L\" [3 9 "
                                                "9]\nShape \"sphere\" \"float radius\" [0.3] \"float alpha\" "
                                                "[0.6]\nAttributeEnd\n",
     ALL},
    /* shapes */
    {"curves",
     HEAD3 PLACE3
     "Shape \"curve\" \"string type\" [\"cylinder\"] \"point P\" [-1.5 0 -0.5 -1 2 -0.5 -0.5 2 0 0.2 0.2 "
     "-0.6] "
     "\"float width0\" [0.3] \"float width1\" [0.1]\n"
     "Shape \"curve\" \"string type\" [\"ribbon\"] \"point P\" [-0.5 0.3 -0.8 0 2 -0.5 0.5 2 0 1.2 1.2 -0.6] "
     "\"normal N\" [0 0.3 -1 0.5 0.5 -1] \"float width\" [0.3]\n" LAMP("12 11 9") END3,
     ALL},
    {"curves-instanced",
     HEAD3 PLACE3
     "ObjectBegin \"thing\"\n"
     "Shape \"curve\" \"string type\" [\"cylinder\"] \"point P\" [-1.5 0 -0.5 -1 2 -0.5 -0.5 2 0 "
     "0.2 0.2 -0.6] \"float width0\" [0.3] \"float width1\" [0.1]\n"
     "Shape \"curve\" \"string type\" [\"ribbon\"] \"point P\" [-0.5 0.3 -0.8 0 2 -0.5 0.5 2 0 "
     "1.2 1.2 -0.6] \"normal N\" [0 0.3 -1 0.5 0.5 -1] \"float width\" [0.3]\nObjectEnd\n"
     "AttributeBegin\nTranslate 0 0.3 0\nScale 0.8 0.9 -1.2\nObjectInstance "
     "\"thing\"\nAttributeEnd\n" LAMP("12 11 9") END3,
     ALL},
    {"quadrics",
     HEAD3 STAGE("matte", "Kd") "Material \"plastic\" \"rgb Kd\" [0.3 0.4 0.2] \"float roughness\" [0.3]\n"
                                "AttributeBegin\nTranslate -0.9 0.5 0\nRotate -60 1 0 0\nShape \"cylinder\" "
                                "\"float radius\" [0.4] \"float "
                                "zmin\" [0] \"float zmax\" [1] \"float phimax\" [240]\nAttributeEnd\n"
                                "AttributeBegin\nTranslate 0.3 1 0\nScale 0.4 0.8 0.5\nShape \"sphere\" "
                                "\"float zmin\" [-0.6] \"float zmax\" "
                                "[0.7] \"float phimax\" [300]\nAttributeEnd\n"
                                "AttributeBegin\nTranslate 1 0.4 -0.6\nRotate 30 0 1 0\nShape \"disk\" "
                                "\"float radius\" [0.4] \"float "
                                "innerradius\" [0.1]\nAttributeEnd\n" LAMP("12 11 9") END3,
     ALL},
    /* materials */
    {"normal-map",
     HEAD4 PLACE4 "AttributeBegin\nMaterial \"coateddiffuse\" \"rgb reflectance\" [0.5 0.4 0.3] \"float "
                  "roughness\" [0.4] \"string normalmap\" \"square.pfm\"\n" QUAD_UV4(
                      "-1.4 0.2 -0.3  -0.2 0.2 -0.6  -0.1 1.6 -0.1  -1.3 1.6 0.2",
                      "") "Material \"diffuse\" \"string normalmap\" \"square.pfm\"\nTranslate 0.5 1.5 0\n"
                          "Shape \"sphere\" \"float radius\" [0.4]\nAttributeEnd\n" LAMP("12 11 9"),
     ALL},
    {"bump-map",
     HEAD3
     "Texture \"wave\" \"float\" \"fbm\"\nTexture \"low\" \"float\" \"scale\" \"texture tex1\" \"wave\" "
     "\"float tex2\" [0.2]\n" PLACE3
     "AttributeBegin\nMaterial \"matte\" \"rgb Kd\" [0.5 0.4 0.3] \"texture bumpmap\" \"low\"\n" QUAD_UV(
         "-1.4 0.2 -0.3  -0.2 0.2 -0.6  -0.1 1.6 -0.1  -1.3 1.6 0.2",
         "") "Material \"plastic\" \"float roughness\" [0.3] \"texture bumpmap\" \"low\"\nTranslate 0.5 1.5 "
             "0\nShape \"sphere\" \"float radius\" [0.4]\nAttributeEnd\n" LAMP("12 11 9") END3,
     ALL},
    {"mix",
     HEAD3
     "Texture \"squares\" \"spectrum\" \"checkerboard\" \"float uscale\" [4] \"float vscale\" [4] \"rgb "
     "tex1\" [0.8 0.2 0.5] \"rgb tex2\" [0 0.3 1]\n"
     "MakeNamedMaterial \"a\" \"string type\" \"matte\" \"rgb Kd\" [0.6 0.3 0.1]\n"
     "MakeNamedMaterial \"b\" \"string type\" \"metal\" \"float roughness\" [0.3]\n"
     "MakeNamedMaterial \"c\" \"string type\" \"mirror\"\n" PLACE3
     "AttributeBegin\nMaterial \"mix\" \"string namedmaterial1\" \"a\" \"string namedmaterial2\" \"b\" "
     "\"texture amount\" \"squares\"\n" QUAD_UV("-1.4 0.2 -0.3  -0.2 0.2 -0.6  -0.1 1.6 -0.1  -1.3 1.6 0.2",
                                                "") "Material \"mix\" \"string namedmaterial1\" \"a\" "
                                                    "\"string namedmaterial2\" \"c\" \"rgb amount\" "
                                                    "[0.7 0.7 0.7]\nTranslate 0.5 1.5 0\nShape \"sphere\" "
                                                    "\"float radius\" [0.4]\nAttributeEnd\n" LAMP("12 11 9")
                                                        END3,
     BDPT | PATH},
    /* sizes */
    {"tiny",
     "LookAt 0 1.6e-4 -5e-4  0 1e-4 0  0 1 0\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 BOX DEPTH5
     "WorldBegin\nScale 1e-4 1e-4 1e-4\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"huge",
     "LookAt 0 1.6e6 -5e6  0 1e6 0  0 1 0\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 BOX DEPTH5
     "WorldBegin\nScale 1e6 1e6 1e6\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
};

/* ---- rendering ----------------------------------------------------------------------------------------- */

static void load(const char *text, uint8_t **bytes, scene_blob_t *blob)
{
    char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, strlen(text));
    uint64_t size;
    result_t made = import_scene_blob(path, NULL, bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(*bytes, size, blob).code, RESULT_OK);
    free(path);
}

static estimate_image_t render_blob(const scene_blob_t *blob, integrator_t integrator, uint32_t spp)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.seed = 11;
    film_t *film = render_here(blob, &settings);
    estimate_image_t estimate = reference_estimate(film);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    film_destroy(&film);
    return estimate;
}

static estimate_image_t render(const char *text, integrator_t integrator, uint32_t spp)
{
    uint8_t *bytes;
    scene_blob_t blob;
    load(text, &bytes, &blob);
    estimate_image_t image = render_blob(&blob, integrator, spp);
    free(bytes);
    return image;
}

/* Mean of all values and its standard error. */
static double mean_of(const estimate_image_t *image, double *error)
{
    double sum = 0, variance = 0, values = 3.0 * image->width * image->height;
    for (size_t i = 0; i < (size_t)values; i++) sum += image->mean[i], variance += image->variance[i];
    *error = sqrt(variance) / values;
    return sum / values;
}

static bool agree(const char *what, const char *who, const estimate_image_t *image,
                  const estimate_image_t *reference)
{
    agreement_t agreement;
    agreement_limits_t limits = agreement_default_limits();
    limits.max_rms = 1.4; /* of 16 blocks */
    agreement_measure(image, reference, &agreement);
    double error, mean = mean_of(image, &error);
    bool sharp = mean > 0 && error < 0.02 * mean, holds = agreement_holds(&agreement, &limits) && sharp;
    print_message("%-24s %-5s mean %.4f, ratio %.4f %.4f %.4f, error %.4f, z rms %.2f max %.2f%s%s\n", what,
                  who, mean, agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2],
                  error / mean, agreement.rms_z, agreement.max_z, holds ? "" : "  <-- differs",
                  sharp ? "" : " (too noisy)");
    agreement_free(&agreement);
    return holds;
}

static bool check(const case_t *c)
{
    estimate_image_t path = render(c->text, INTEGRATOR_PATH, 256),
                     bdpt = render(c->text, INTEGRATOR_BDPT, 96);
    bool holds = agree(c->name, "bdpt", &bdpt, &path);
    if (c->integrators & LIGHT) {
        estimate_image_t light = render(c->text, INTEGRATOR_LIGHT, 384);
        holds = agree(c->name, "light", &light, &path) && holds;
        estimate_image_free(&light);
    }
    estimate_image_free(&path);
    estimate_image_free(&bdpt);
    return holds;
}

static void integrators_agree(void **state)
{
    (void)state;
    int differing = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        if (only_scene == NULL || strcmp(only_scene, cases[i].name) == 0) differing += !check(&cases[i]);
    assert_int_equal(differing, 0);
}

/* ---- images of lights ---------------------------------------------------------------------------------- */

/* A smooth pattern with a bright spot and a dark part, rows from the bottom. */
static void write_image(const char *name, int width, int height)
{
    char header[64];
    size_t length = (size_t)snprintf(header, sizeof header, "PF\n%d %d\n-1.0\n", width, height);
    size_t size = length + 12 * (size_t)width * (size_t)height;
    uint8_t *bytes = mem_alloc(size);
    memcpy(bytes, header, length);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            float s = ((float)x + 0.5f) / (float)width, t = ((float)y + 0.5f) / (float)height;
            float base = s < 0.25f ? 0 : 0.5f + 0.4f * sinf(9 * s) * cosf(7 * t);
            float spot = x == width / 2 && y == height / 2 ? 1 : 0;
            float rgb[3] = {base + spot, base * t + spot, 0.5f * (base + 1 - s)};
            memcpy(bytes + length + 12 * ((size_t)y * (size_t)width + (size_t)x), rgb, 12);
        }
    char *path = scratch_path(folder, name);
    scratch_write(path, bytes, size);
    free(path);
    free(bytes);
}

static int begin(void **state)
{
    (void)state;
    folder = scratch_new();
    write_image("wide.pfm", 16, 8);
    write_image("square.pfm", 8, 8);
    return 0;
}

static int end(void **state)
{
    (void)state;
    scratch_destroy(&folder);
    return 0;
}

int main(int argc, char **argv)
{
    only_scene = argc > 1 ? argv[1] : NULL;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(integrators_agree),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
