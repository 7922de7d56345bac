/* The integrators against one another, on small scenes of what the reference images (test_references.c) do
 * not show: they share cameras, lights and shapes, but each asks other questions of them. Scenes are pbrt
 * text, so that the importer is tested as well. */
#include "client/import/import.h"
#include "tests/bsdf_files.h"
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

enum { BDPT = 1, PATH = 2, LIGHT = 4, VCM = 8, PLAIN = BDPT | PATH | LIGHT, ALL = PLAIN | VCM };

/* A scene that the integrators must agree on. */
typedef struct {
    const char *name, *text;
    int integrators;
} case_t;

static const case_t cases[] = {
    /* cameras, which merging knows nothing of */
    {"orthographic",
     LOOK "Camera \"orthographic\" \"float screenwindow\" [-1.8 1.8 -1 2.6]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"orthographic-sky",
     LOOK "Camera \"orthographic\" \"float screenwindow\" [-2.4 2.4 -1.4 3.4]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 "LightSource \"infinite\" \"rgb L\" [1 0.8 0.6]\n" END3,
     PLAIN},
    {"orthographic-scaled",
     LOOK "Scale 2 2 2\nCamera \"orthographic\" \"float screenwindow\" [-2.4 2.4 -1.4 3.4]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"environment",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"environment\"\n" FILM3 BOX DEPTH5
     "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     ALL},
    {"environment-gaussian",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"environment\"\n" FILM3
     "PixelFilter \"gaussian\" \"float xwidth\" [3] \"float ywidth\" [3] \"float alpha\" [0.3]\n" DEPTH5
     "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"equal-area",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"spherical\"\n" FILM4 BOX4 DEPTH5
     "WorldBegin\n" PLACE4 LAMP("12 11 9"),
     PLAIN},
    {"equal-area-gaussian",
     "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"spherical\"\n" FILM4
     "PixelFilter \"gaussian\" \"float xradius\" [3] \"float yradius\" [3] \"float sigma\" [1]\n" DEPTH5
     "WorldBegin\n" PLACE4 LAMP("12 11 9"),
     PLAIN},
    {"lens",
     LOOK "Camera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.4] \"float focaldistance\" "
          "[4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"lens-scaled",
     LOOK "Scale -2 2 2\nCamera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.4] \"float "
          "focaldistance\" [4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"camera-stretched",
     LOOK "Scale 1 1.7 1.3\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 BOX DEPTH5
          "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"camera-moves",
     LOOK "ActiveTransform EndTime\nTranslate 0.3 0.1 0.4\nRotate 8 0.2 1 0.4\nActiveTransform All\n"
          "Camera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.1] \"float focaldistance\" "
          "[4]\n" FILM3 BOX DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"instance-moves",
     HEAD3 PLACE3
     "ObjectBegin \"thing\"\nTranslate 0 0 0\nScale 0.3 0.5 0.3\n" CUBE
     "Translate 0 1.4 0\nShape \"sphere\" \"float phimax\" [250]\nObjectEnd\n"
     "AttributeBegin\nTranslate -0.8 0.6 0\nActiveTransform EndTime\nTranslate 0.5 0.2 "
     "-0.4\nRotate 50 1 1 0\nScale 1 1 1.5\nActiveTransform All\nObjectInstance \"thing\"\nAttributeEnd\n"
     "AttributeBegin\nTranslate 0.8 1.5 0\nScale -0.7 0.7 0.7\nActiveTransform EndTime\nTranslate "
     "0.5 0.2 -0.4\nRotate 120 0 1 0.4\nActiveTransform All\nObjectInstance "
     "\"thing\"\nAttributeEnd\n" LAMP("12 11 9") END3,
     PLAIN},
    /* filters */
    {"mitchell",
     PERSPECTIVE FILM3 "PixelFilter \"mitchell\"\n" DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3, PLAIN},
    {"sinc", PERSPECTIVE FILM3 "PixelFilter \"sinc\"\n" DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"gaussian",
     PERSPECTIVE FILM3 "PixelFilter \"gaussian\" \"float xwidth\" [2.5] \"float ywidth\" [1.5]\n" DEPTH5
                       "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    {"narrow",
     PERSPECTIVE FILM3 "PixelFilter \"triangle\" \"float xwidth\" [0.3] \"float ywidth\" [0.7]\n" DEPTH5
                       "WorldBegin\n" PLACE3 LAMP("12 11 9") END3,
     PLAIN},
    /* lights */
    {"disk-light",
     HEAD3 PLACE3 "AttributeBegin\nTranslate -0.4 2.5 0\nRotate 70 1 0 0\nScale 0.8 0.4 1\n"
                  "AreaLightSource \"diffuse\" \"rgb L\" [20 15 12]\nShape \"disk\" \"float radius\" [1] "
                  "\"float innerradius\" [0.4] \"float phimax\" [220]\nAttributeEnd\n" END3,
     ALL},
    {"unseen-lights",
     HEAD4 PLACE4
     "AttributeBegin\nAttribute \"shape\" \"float alpha\" [0]\nAreaLightSource \"diffuse\" \"rgb L\" [12 11 "
     "9]\n" QUAD(
         "-0.5 1.6 -0.5  0.5 1.6 -0.5  0.5 1.6 0.5  -0.5 1.6 0.5") "AreaLightSource \"diffuse\" \"rgb L\" [2 "
                                                                   "5 9] "
                                                                   "\"bool twosided\" true\nTranslate -0.9 "
                                                                   "0.6 "
                                                                   "0\nShape \"sphere\" \"float radius\" "
                                                                   "[0.3]\nAttributeEnd\n",
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
    {"hair", /* as fibres, on which light subpaths end, and on surfaces */
     HEAD3 PLACE3
     "Material \"hair\" \"float eumelanin\" [0.3] \"float beta_m\" [0.4]\n"
     "Shape \"curve\" \"string type\" [\"cylinder\"] \"point P\" [-1.5 0 -0.5 -1 2 -0.5 -0.5 2 0 0.2 0.2 "
     "-0.6] \"float width0\" [0.06] \"float width1\" [0.03]\n"
     "Shape \"curve\" \"point P\" [-1.2 0.2 -0.8 -0.3 1.2 -0.9 0.5 1.3 -0.7 1.3 0.7 -0.8] "
     "\"float width\" [0.04]\n"
     "Material \"hair\" \"rgb color\" [0.8 0.6 0.3] \"float beta_m\" [0.5] \"float beta_n\" [0.5]\n"
     "Shape \"curve\" \"string type\" [\"ribbon\"] \"point P\" [-0.5 0.3 -0.8 0 2 -0.5 0.5 2 0 1.2 1.2 -0.6] "
     "\"normal N\" [0 0.3 -1 0.5 0.5 -1] \"float width\" [0.3]\n"
     "Translate -0.9 0.4 -0.9\nShape \"sphere\" \"float radius\" [0.3]\n" LAMP("12 11 9") END3,
     BDPT | PATH | VCM},
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
     BDPT | PATH | VCM},
    {"fourier", /* from a table that is not reciprocal, and lets light through */
     HEAD3 STAGE("matte", "Kd") "Material \"fourier\" \"string bsdffile\" \"skewed.bsdf\"\n" BALL QUAD(
         "-1.4 0.2 -0.3  -0.2 0.2 -0.6  -0.1 1.6 -0.1  -1.3 1.6 0.2") LAMP("12 11 9") END3,
     ALL},
    {"measured", /* not reciprocal either */
     HEAD4 STAGE("diffuse",
                 "reflectance") "Material \"measured\" \"string filename\" \"measured.bsdf\"\n" BALL
         QUAD_UV4("-1.4 0.2 -0.3  -0.2 0.2 -0.6  -0.1 1.6 -0.1  -1.3 1.6 0.2", "") LAMP("12 11 9"),
     ALL},
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

static estimate_image_t render_merging(const scene_blob_t *blob, integrator_t integrator, uint32_t spp,
                                       double radius)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.seed = 11;
    settings.merge_radius = radius;
    film_t *film = render_here(blob, &settings);
    estimate_image_t estimate = reference_estimate(film);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    film_destroy(&film);
    return estimate;
}

static estimate_image_t render_blob(const scene_blob_t *blob, integrator_t integrator, uint32_t spp)
{
    return render_merging(blob, integrator, spp, 0);
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

/* By vcm, with a radius that hardly blurs, for a scene a few units wide but where its name says otherwise. */
static estimate_image_t render_vcm(const case_t *c, uint32_t spp)
{
    uint8_t *bytes;
    scene_blob_t blob;
    load(c->text, &bytes, &blob);
    double unit = strcmp(c->name, "tiny") == 0 ? 1e-4 : strcmp(c->name, "huge") == 0 ? 1e6 : 1;
    estimate_image_t image = render_merging(&blob, INTEGRATOR_VCM, spp, 0.03 * unit);
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
    bool sharp = mean > 0 && error < 0.025 * mean, holds = agreement_holds(&agreement, &limits) && sharp;
    print_message("%-24s %-5s mean %.4f, ratio %.4f %.4f %.4f, error %.4f, z rms %.2f max %.2f%s%s\n", what,
                  who, mean, agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2],
                  error / mean, agreement.rms_z, agreement.max_z, holds ? "" : "  <-- differs",
                  sharp ? "" : " (too noisy)");
    agreement_free(&agreement);
    return holds;
}

static bool check(const case_t *c)
{
    /* All others are held to path, whose noise must be known best. */
    estimate_image_t path = render(c->text, INTEGRATOR_PATH, 256),
                     bdpt = render(c->text, INTEGRATOR_BDPT, 48);
    bool holds = agree(c->name, "bdpt", &bdpt, &path);
    if (c->integrators & VCM) {
        estimate_image_t vcm = render_vcm(c, 64);
        holds = agree(c->name, "vcm", &vcm, &path) && holds;
        estimate_image_free(&vcm);
    }
    if (c->integrators & LIGHT) {
        estimate_image_t light = render(c->text, INTEGRATOR_LIGHT, 128);
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

/* ---- films --------------------------------------------------------------------------------------------- */

static estimate_image_t part_of(const estimate_image_t *whole, int x0, int y0, int width, int height)
{
    size_t values = 3 * (size_t)width * (size_t)height;
    estimate_image_t part = {width, height, mem_alloc(values * sizeof(double)),
                             mem_alloc(values * sizeof(double))};
    for (int y = 0; y < height; y++) {
        size_t from = 3 * ((size_t)(y + y0) * (size_t)whole->width + (size_t)x0),
               to = 3 * (size_t)y * (size_t)width;
        memcpy(part.mean + to, whole->mean + from, 3 * (size_t)width * sizeof(double));
        memcpy(part.variance + to, whole->variance + from, 3 * (size_t)width * sizeof(double));
    }
    return part;
}

#define CROPPED(camera, filter, crop)                                                                        \
    camera "Film \"image\" \"integer xresolution\" [64] \"integer yresolution\" [48] \"float cropwindow\" "  \
           "[" crop "]\n" filter DEPTH5 "WorldBegin\n" PLACE3 LAMP("12 11 9") END3

static void check_crop(const char *name, const char *whole_text, const char *part_text)
{
    estimate_image_t whole = render(whole_text, INTEGRATOR_PATH, 96);
    assert_int_equal(whole.width, 64);
    assert_int_equal(whole.height, 48);
    estimate_image_t expected = part_of(&whole, 32, 16, 32, 24);
    bool holds = true;
    static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT, INTEGRATOR_LIGHT};
    static const uint32_t spp[] = {96, 48, 512};
    for (size_t i = 0; i < ARRAY_LENGTH(integrators); i++) {
        estimate_image_t part = render(part_text, integrators[i], spp[i]);
        assert_int_equal(part.width, 32);
        assert_int_equal(part.height, 24);
        holds = agree(name, integrator_name(integrators[i]), &part, &expected) && holds;
        estimate_image_free(&part);
    }
    estimate_image_free(&whole);
    estimate_image_free(&expected);
    assert_true(holds);
}

/* A part of the film is the same part of the whole picture, what falls over its edges included. */
static void crops_are_parts(void **state)
{
    (void)state;
#define PART "0.5 1 0.3333 0.8333"
#define WIDE "PixelFilter \"gaussian\" \"float xwidth\" [2.5] \"float ywidth\" [2.5]\n"
#define AROUND "LookAt 0 1.2 -1  0.3 1 0  0.1 1 0\nCamera \"environment\"\n"
    check_crop("crop", CROPPED(PERSPECTIVE, BOX, "0 1 0 1"), CROPPED(PERSPECTIVE, BOX, PART));
    check_crop("crop-wide", CROPPED(PERSPECTIVE, WIDE, "0 1 0 1"), CROPPED(PERSPECTIVE, WIDE, PART));
    check_crop("crop-around", CROPPED(AROUND, WIDE, "0 1 0 1"), CROPPED(AROUND, WIDE, PART));
}

/* Filters move light about on the film but do not change its sum, where nothing crosses the film's edges. */
static void filters_keep_the_mean(void **state)
{
    (void)state;
#define DISTANT_BALL(filter)                                                                                 \
    "LookAt 0 0 -9 0 0 0 0 1 0\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 filter DEPTH5             \
    "WorldBegin\nLightSource \"distant\" \"rgb L\" [3 3 3] \"point from\" [-1 2 -2]\nShape \"sphere\" "      \
    "\"float "                                                                                               \
    "radius\" [1.7]\n" END3
    static const char *const texts[] = {
        DISTANT_BALL(BOX), DISTANT_BALL("PixelFilter \"mitchell\"\n"), DISTANT_BALL("PixelFilter \"sinc\"\n"),
        DISTANT_BALL("PixelFilter \"gaussian\"\n"),
        DISTANT_BALL("PixelFilter \"triangle\" \"float xwidth\" [3] \"float ywidth\" [1]\n")};
    double truth = 0, truth_error = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(texts); i++)
        for (int k = 0; k < 2; k++) {
            estimate_image_t image = render(texts[i], k == 0 ? INTEGRATOR_PATH : INTEGRATOR_BDPT, 256);
            double error, mean = mean_of(&image, &error);
            if (i == 0 && k == 0) truth = mean, truth_error = error;
            print_message("filter %zu: %.5f +- %.5f, box %.5f\n", i, mean, error, truth);
            assert_true(error < 0.01 * mean);
            assert_true(fabs(mean - truth) < 4.5 * hypot(error, truth_error));
            estimate_image_free(&image);
        }
}

/* ---- truths -------------------------------------------------------------------------------------------- */

static void assert_constant(const estimate_image_t *image, double truth, double tolerance)
{
    for (size_t i = 0; i < 3 * (size_t)image->width * (size_t)image->height; i++)
        if (!(fabs(image->mean[i] - truth) <= tolerance))
            fail_msg("value %zu is %.6f, expected %.6f", i, image->mean[i], truth);
}

/* A white convex thing that loses no light vanishes in front of a sky of 1, one scattering being enough: each
 * sample of path is exactly 1 but for the choice between its strategies. */
static void white_things_vanish(void **state)
{
    (void)state;
    static const char *const things[] = {
        "Material \"matte\" \"rgb Kd\" [1 1 1]\nShape \"sphere\" \"float radius\" [0.8]\n",
        "Material \"matte\" \"rgb Kd\" [1 1 1]\nScale 0.5 0.9 0.6\nRotate 30 1 1 0\nShape \"sphere\"\n",
        "Material \"matte\" \"rgb Kd\" [1 1 1]\nScale 0.5 0.5 0.5\nRotate 30 1 1 0\n" CUBE,
        "Material \"matte\" \"rgb Kd\" [1 1 1]\nRotate 50 1 1 0\nShape \"disk\"\n",
        "Material \"mirror\" \"rgb Kr\" [1 1 1]\nShape \"sphere\" \"float radius\" [0.8]\n",
        "Material \"matte\" \"rgb Kd\" [1 1 1]\nObjectBegin \"a\"\nRotate 50 1 1 0\nShape "
        "\"disk\"\nObjectEnd\n"
        "ActiveTransform EndTime\nTranslate 0.4 0.4 0\nRotate 80 0 0 1\nScale 1 0.5 1\nActiveTransform "
        "All\nObjectInstance \"a\"\n",
    };
    static const char *const skies[] = {
        "LightSource \"infinite\" \"rgb L\" [1 1 1]\n",
        "AttributeBegin\nRotate 30 1 1 0\nScale 1 2 1\nLightSource \"infinite\" \"string mapname\" "
        "[\"white.pfm\"]\nAttributeEnd\n",
    };
    static const char *const cameras[] = {
        "LookAt 0 0 -4 0 0 0 0 1 0\nCamera \"perspective\" \"float fov\" [40]\n",
        "LookAt 0 0 -4 0 0 0 0 1 0\nCamera \"orthographic\" \"float screenwindow\" [-1.5 1.5 -1.5 1.5]\n",
    };
    for (size_t i = 0; i < ARRAY_LENGTH(things); i++) {
        char *text = mem_printf("%s" FILM3 BOX "Sampler \"sobol\"\nIntegrator \"bdpt\" \"integer maxdepth\" "
                                "[%d]\nWorldBegin\n%s%s" END3,
                                cameras[i & 1], i == 3 ? 1 : 3, skies[i % 2], things[i]);
        for (int k = 0; k < 2; k++) {
            estimate_image_t image = render(text, k == 0 ? INTEGRATOR_PATH : INTEGRATOR_BDPT, 64);
            double error, mean = mean_of(&image, &error);
            print_message("thing %zu: %.5f +- %.5f\n", i, mean, error);
            assert_true(error < 0.002);
            assert_true(fabs(mean - 1) < 4.5 * error + 1e-5);
            estimate_image_free(&image);
        }
        free(text);
    }
}

/* Scenes with next to nothing in them. */
static void poor_scenes_render(void **state)
{
    (void)state;
    static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT, INTEGRATOR_LIGHT};
    static const struct {
        const char *world;
        double value; /* < 0: anything finite */
    } worlds[] = {
        {"LightSource \"infinite\" \"rgb L\" [1 1 1]\n", 1},
        {"LightSource \"infinite\" \"string mapname\" [\"white.pfm\"]\n", 1},
        {"", 0},
        {"LightSource \"point\"\nLightSource \"distant\"\n", 0},
        {"Shape \"sphere\"\n", 0},
        {"LightSource \"point\" \"point from\" [0 0 -5]\nTranslate 0 0 -5\nShape \"sphere\" \"float radius\" "
         "[1e-20]\n",
         -1},
        {"AreaLightSource \"diffuse\" \"rgb L\" [1 1 1]\nShape \"sphere\" \"float radius\" [1e-12]\n", -1},
        {"LightSource \"infinite\" \"rgb L\" [1 1 1]\n" QUAD("0 0 0 1e-8 0 0 1e-8 1e-8 0 0 1e-8 0"), 1},
        {"LightSource \"distant\"\nLightSource \"infinite\"\n" QUAD(
             "-1e15 -1 -1e15  1e15 -1 -1e15  1e15 -1 1e15  -1e15 -1 1e15"),
         -1},
        {"LightSource \"spot\" \"float coneangle\" [0.001]\nLightSource \"spot\" \"float coneangle\" "
         "[180]\n" PLACE3,
         -1},
        {"LightSource \"goniometric\" \"string mapname\" [\"black.pfm\"]\nLightSource \"infinite\" \"string "
         "mapname\" [\"black.pfm\"]\nLightSource \"projection\" \"string mapname\" [\"black.pfm\"]\n" PLACE3,
         0},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(worlds); i++)
        for (size_t k = 0; k < ARRAY_LENGTH(integrators); k++) {
            char *text = mem_printf("%s%s%s", HEAD3, worlds[i].world, END3);
            estimate_image_t image = render(text, integrators[k], 4);
            if (worlds[i].value >= 0) assert_constant(&image, worlds[i].value, 1e-5);
            free(text);
            estimate_image_free(&image);
        }
}

/* A sheet that stops shadow rays only in part: what it does is defined where a path is joined to a light. */
static void shadow_alpha_lets_light_through(void **state)
{
    (void)state;
#define UNDER_SHEET(sheet)                                                                                   \
    "LookAt 0 3 0 0 0 0 0 0 1\nCamera \"perspective\" \"float fov\" [40]\n" FILM3 BOX                        \
    "Sampler \"sobol\"\nIntegrator \"path\" \"integer maxdepth\" [1]\nWorldBegin\nLightSource \"distant\" "  \
    "\"point from\" [0 1 0] \"point to\" [0 0 0]\n" QUAD(FLOOR) sheet END3
#define SHEET(alpha) QUAD_UV("-2 4 -2 2 4 -2 2 4 2 -2 4 2", alpha)
    static const struct {
        const char *text;
        double light;
    } cases_of[] = {
        {UNDER_SHEET(""), 1},
        {UNDER_SHEET(SHEET("")), 0},
        {UNDER_SHEET(SHEET("\"float shadowalpha\" [0]")), 1},
        {UNDER_SHEET(SHEET("\"float alpha\" [0]")), 1},
        {UNDER_SHEET("Texture \"t\" \"float\" \"checkerboard\" \"float uscale\" [400] \"float vscale\" [400] "
                     "\"float tex1\" [1] \"float tex2\" [0]\n" SHEET("\"texture shadowalpha\" \"t\"")),
         0.5},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases_of); i++) {
        estimate_image_t image = render(cases_of[i].text, INTEGRATOR_PATH, 64);
        double error, mean = mean_of(&image, &error);
        if (!(fabs(mean * M_PI / 0.5 - cases_of[i].light) < 0.01))
            fail_msg("sheet %zu: %.4f, expected %.4f", i, mean * M_PI / 0.5, cases_of[i].light);
        estimate_image_free(&image);
    }
}

/* Of sheets one behind the other each stops its share of what is left. */
static void sheets_stop_independently(void **state)
{
    (void)state;
#define THROUGH(sheets)                                                                                      \
    "LookAt 0 0 -5 0 0 0 0 1 0\nCamera \"perspective\" \"float fov\" [20]\n" FILM4 BOX4                      \
    "Sampler \"independent\"\nIntegrator \"path\"\nWorldBegin\nLightSource \"infinite\" \"rgb L\" [1 1 1]\n" \
    "Material \"diffuse\" \"rgb reflectance\" [0 0 0]\n" sheets
#define VEIL(z)                                                                                              \
    "Shape \"trianglemesh\" \"integer indices\" [0 1 2] \"point3 P\" [-9 -9 " z " 9 -9 " z " 0 18 " z        \
    "] \"float alpha\" [0.5]\n"
#define GLOBE "Shape \"sphere\" \"float radius\" [3] \"float alpha\" [0.5]\n"
    static const struct {
        const char *text;
        double passes;
    } stacks[] = {
        {THROUGH(VEIL("0")), 0.5},
        {THROUGH(VEIL("0") VEIL("1")), 0.25},
        {THROUGH(VEIL("0") VEIL("1") VEIL("1.5")), 0.125},
        {THROUGH(GLOBE), 0.25},
        {THROUGH(GLOBE VEIL("0") "Translate 0 0 0.5\n" GLOBE), 1.0 / 32},
        {THROUGH("ObjectBegin \"a\"\n" VEIL("0") "ObjectEnd\nObjectInstance \"a\"\nTranslate 0 0 1\n"
                                                 "ObjectInstance \"a\"\n"),
         0.25},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(stacks); i++) {
        estimate_image_t image = render(stacks[i].text, INTEGRATOR_PATH, 64);
        double error, mean = mean_of(&image, &error), passes = stacks[i].passes;
        double expected_error = sqrt(passes * (1 - passes) / (SIDE * SIDE * 64));
        if (!(fabs(mean - passes) < 4.5 * expected_error))
            fail_msg("stack %zu: %.4f +- %.4f passes, expected %.4f", i, mean, expected_error, passes);
        estimate_image_free(&image);
    }
}

/* glTF's solid glass. */
static blob_material_t glass_of(float roughness)
{
    blob_material_t glass = {.kind = MATERIAL_GLTF};
    glass.values[VALUE_REFLECTANCE] = glass.values[VALUE_TRANSMISSION] = blob_constant(1);
    glass.values[VALUE_ROUGHNESS_U] = blob_constant(roughness);
    glass.values[VALUE_ETA] = blob_constant(1.4f);
    glass.values[VALUE_SPECULAR] = glass.values[VALUE_SPECULAR_COLOUR] = blob_constant(1);
    return glass;
}

/* A ball of it in a room. */
static test_scene_t glass_scene(blob_material_t glass, bool filled)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -2), 50, SIDE);
    blob_material_t matte = {.kind = MATERIAL_DIFFUSE};
    matte.values[VALUE_REFLECTANCE] = blob_constant(0.6f);
    uint32_t ball = test_scene_material(&scene, glass), wall = test_scene_material(&scene, matte);
    test_scene_room(&scene, vec3(-1.5f, -1.5f, -2.5f), vec3(1.5f, 1.5f, 1.5f), wall, vec3(0, 0, 0));
    test_scene_rectangle(&scene, vec3(-0.5f, 1.4f, -0.5f), vec3(1, 0, 0), vec3(0, 0, 1), wall, vec3(6, 6, 6));
    test_scene_sphere(&scene, vec3(0, 0, 0), 0.8f, ball, vec3(0, 0, 0));
    if (filled) {
        test_scene_sphere(&scene, vec3(0.25f, 0, -0.1f), 0.2f, wall, vec3(3, 3, 3));
        test_scene_sphere(&scene, vec3(-0.3f, -0.1f, 0), 0.25f, wall, vec3(0, 0, 0));
    }
    test_scene_finish(&scene);
    return scene;
}

/* Rough glass that absorbs most of the blue; without and with a lamp and a ball in it. */
static void glass_absorbs(void **state)
{
    (void)state;
    blob_material_t glass = glass_of(0.3f);
    glass.values[VALUE_ATTENUATION] = blob_colour_value(vec3(0.5f, 1, 2));
    for (int filled = 0; filled < 2; filled++) {
        test_scene_t scene = glass_scene(glass, filled);
        estimate_image_t path = render_blob(&scene.blob, INTEGRATOR_PATH, 192),
                         bdpt = render_blob(&scene.blob, INTEGRATOR_BDPT, 48),
                         light = render_blob(&scene.blob, INTEGRATOR_LIGHT, 192);
        size_t middle = 3 * (SIDE * SIDE / 2 + SIDE / 2);
        assert_true(path.mean[middle] > (filled ? 1.2f : 2) * path.mean[middle + 2]);
        const char *name = filled ? "absorbing glass with a lamp and a ball" : "absorbing glass";
        bool holds = agree(name, "bdpt", &bdpt, &path);
        holds = agree(name, "light", &light, &path) && holds;
        estimate_image_free(&path);
        estimate_image_free(&bdpt);
        estimate_image_free(&light);
        test_scene_end(&scene);
        assert_true(holds);
    }
}

/* Glass that refracts each colour its own way: the subpaths of a path come to their colours apart. */
static void glass_disperses(void **state)
{
    (void)state;
    for (int rough = 0; rough < 2; rough++) {
        blob_material_t glass = glass_of(rough ? 0.4f : 0);
        glass.values[VALUE_DISPERSION] = blob_constant(8);
        test_scene_t scene = glass_scene(glass, false);
        estimate_image_t path = render_blob(&scene.blob, INTEGRATOR_PATH, 128),
                         bdpt = render_blob(&scene.blob, INTEGRATOR_BDPT, 32);
        bool holds = agree(rough ? "rough prism" : "smooth prism", "bdpt", &bdpt, &path);
        estimate_image_free(&path);
        estimate_image_free(&bdpt);
        test_scene_end(&scene);
        assert_true(holds);
    }
}

/* Deep paths: eye and light subpaths never use the same numbers. Pixels share light subpaths, which are all
 * the luck there is here, so that only images of other seeds tell how sure the mean is. */
static void deep_paths_agree(void **state)
{
    (void)state;
    enum { IMAGES = 16 };
    test_scene_t scene = test_scene_begin(vec3(0.3f, 0.2f, 0.1f), 70, 16);
    blob_material_t matte = {.kind = MATERIAL_DIFFUSE};
    matte.values[VALUE_REFLECTANCE] = blob_constant(0.96f);
    uint32_t wall = test_scene_material(&scene, matte);
    test_scene_room(&scene, vec3(-1, -1.5f, -2), vec3(2, 1, 3), wall, vec3(1, 1, 1));
    test_scene_finish(&scene);
    static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT};
    for (size_t i = 0; i < ARRAY_LENGTH(integrators); i++) {
        job_settings_t settings = blob_default_settings(&scene.blob);
        settings.integrator = integrators[i];
        settings.spp = integrators[i] == INTEGRATOR_BDPT ? 32 : 16;
        settings.max_depth = JOB_MAX_DEPTH;
        double sum = 0, squares = 0, truth = (1 - pow(0.96, JOB_MAX_DEPTH + 1)) / 0.04;
        for (settings.seed = 1; settings.seed <= IMAGES; settings.seed++) {
            film_t *film = render_here(&scene.blob, &settings);
            estimate_image_t image = reference_estimate(film);
            double error, mean = mean_of(&image, &error);
            sum += mean;
            squares += mean * mean;
            film_destroy(&film);
            estimate_image_free(&image);
        }
        double mean = sum / IMAGES, error = sqrt((squares / IMAGES - mean * mean) / (IMAGES - 1));
        print_message("deep %s: %.4f +- %.4f, expected %.4f\n", integrator_name(integrators[i]), mean, error,
                      truth);
        assert_true(error < 0.015 * mean);
        assert_true(fabs(mean - truth) < 4.5 * error);
    }
    test_scene_end(&scene);
}

/* What a scene asks for at the price of a bias: no more than a sensible picture is promised. */
static void biases_render(void **state)
{
    (void)state;
    static const char *const texts[] = {
        PERSPECTIVE FILM4 BOX4
        "Sampler \"sobol\"\nIntegrator \"path\" \"bool regularize\" true\nWorldBegin\n" PLACE4
        "Material \"dielectric\"\nTranslate 0.3 0.6 -0.6\nShape \"sphere\" \"float radius\" [0.5]\n" LAMP(
            "12 11 9"),
        PERSPECTIVE FILM4 BOX4
        "Sampler \"sobol\"\nIntegrator \"path\" \"bool regularize\" false\nWorldBegin\n" PLACE4
        "Material \"dielectric\"\nTranslate 0.3 0.6 -0.6\nShape \"sphere\" \"float radius\" [0.5]\n" LAMP(
            "12 11 9"),
    };
    double means[2][3];
    static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT, INTEGRATOR_LIGHT};
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 3; k++) {
            double error;
            estimate_image_t image = render(texts[i], integrators[k], 32);
            means[i][k] = mean_of(&image, &error);
            estimate_image_free(&image);
        }
    for (int k = 0; k < 3; k++) assert_true(fabs(means[0][k] - means[1][k]) < 0.2 * means[1][k]);
}

/* ---- what the eye meets first -------------------------------------------------------------------------- */

/* A ball in front of the sky: its share of the film, its distance, its normals, also by a lens. */
static void first_hits_tell_the_scene(void **state)
{
    (void)state;
    static const char *const cameras[] = {
        "Camera \"orthographic\" \"float screenwindow\" [-2 2 -2 2]\n",
        "Camera \"perspective\" \"float fov\" [40] \"float lensradius\" [0.2] \"float focaldistance\" [5]\n",
    };
    for (int i = 0; i < 2; i++) {
        char *text =
            mem_printf("LookAt 0 0 -6 0 0 0 0 1 0\n%s" FILM3 BOX DEPTH5
                       "WorldBegin\nLightSource \"infinite\"\nMaterial \"matte\" \"rgb Kd\" [0.2 0.4 0.6]\n"
                       "Shape \"sphere\" \"float radius\" [1]\n" END3,
                       cameras[i]);
        uint8_t *bytes;
        scene_blob_t blob;
        load(text, &bytes, &blob);
        job_settings_t settings = blob_default_settings(&blob);
        settings.spp = 32;
        settings.features = true;
        film_t *film = render_here(&blob, &settings);
        film_image_t image;
        film_resolve(film, &image);
        double coverage = 0, pixels = SIDE * SIDE;
        for (size_t p = 0; p < SIDE * SIDE; p++) coverage += (double)image.coverage[p] / pixels;
        if (i == 0) assert_true(fabs(coverage - M_PI / 16) < 0.004);
        size_t middle = SIDE * SIDE / 2 + SIDE / 2;
        assert_true(fabsf(image.depth[middle] - 5) < 0.03f);
        assert_true(fabsf(image.normal[3 * middle + 2] + 1) < 0.03f);
        assert_true(fabsf(image.position[3 * middle + 2] + 1) < 0.03f);
        assert_true(fabsf(image.albedo[3 * middle + 1] - 0.4f) < 1e-5f);
        assert_true(image.object[middle] == 1 && image.object[0] == 0 && image.coverage[0] == 0);
        film_image_free(&image);
        film_destroy(&film);
        free(bytes);
        free(text);
    }
}

/* ---- images of lights ---------------------------------------------------------------------------------- */

/* 2 x 2 texels of one value. */
static void write_plain(const char *name, float value)
{
    static const char header[] = "PF\n2 2\n-1.0\n";
    uint8_t bytes[sizeof header - 1 + 48];
    memcpy(bytes, header, sizeof header - 1);
    for (size_t i = 0; i < 12; i++) memcpy(bytes + sizeof header - 1 + 4 * i, &value, 4);
    char *path = scratch_path(folder, name);
    scratch_write(path, bytes, sizeof bytes);
    free(path);
}

static void write_table(const char *name, uint8_t *bytes, size_t size)
{
    char *path = scratch_path(folder, name);
    scratch_write(path, bytes, size);
    free(path);
    free(bytes);
}

static int begin(void **state)
{
    (void)state;
    folder = scratch_new();
    size_t size;
    uint8_t *table = fourier_file(12, 3, 16, 1.2f, fourier_skewed, &size);
    write_table("skewed.bsdf", table, size);
    table = measured_file(false, true, 0.7, &size);
    write_table("measured.bsdf", table, size);
    scratch_write_light_image(folder, "wide.pfm", 16, 8, 1);
    scratch_write_light_image(folder, "square.pfm", 8, 8, 1);
    write_plain("white.pfm", 1);
    write_plain("black.pfm", 0);
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
        cmocka_unit_test(crops_are_parts),
        cmocka_unit_test(filters_keep_the_mean),
        cmocka_unit_test(white_things_vanish),
        cmocka_unit_test(poor_scenes_render),
        cmocka_unit_test(shadow_alpha_lets_light_through),
        cmocka_unit_test(sheets_stop_independently),
        cmocka_unit_test(glass_absorbs),
        cmocka_unit_test(glass_disperses),
        cmocka_unit_test(deep_paths_agree),
        cmocka_unit_test(biases_render),
        cmocka_unit_test(first_hits_tell_the_scene),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
