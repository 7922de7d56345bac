/* What the pbrt importer refuses, with the place and the words; and that no input makes it crash. */
#include "tests/unit/client/import/test_import.h"

#include <sys/stat.h>

#define TRIANGLE "Shape \"trianglemesh\" \"point3 P\" [0 0 0  1 0 0  0 1 0]\n"

typedef struct {
    const char *text, *message;
} case_t;

/* Every text must fail with RESULT_INPUT and a message that holds "s.pbrt:" and the expected one, when the
 * import is strict. */
static void expect_errors(const case_t *cases, size_t count)
{
    bench_t bench = {.strict = true};
    for (size_t i = 0; i < count; ++i) {
        bench_run(&bench, cases[i].text);
        if (bench.result.code != RESULT_INPUT) fail_msg("accepted: %s", cases[i].text);
        char *expected = mem_printf("s.pbrt:%s", cases[i].message);
        expect_text(bench.result.message, expected);
        free(expected);
    }
    bench_close(&bench);
}

#define EXPECT_ERRORS(cases) expect_errors(cases, ARRAY_LENGTH(cases))

static void errors_of_syntax_name_their_place(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {"", "1:1: the file ends before WorldBegin"},
        {"# nothing\n", "2:1: the file ends before WorldBegin"},
        {"Wurst\n", "1:1: unknown directive \"Wurst\""},
        {"\n\n  42", "3:3: unknown directive \"42\""},
        {"\"Shape\"", "1:1: expected a directive, found \"Shape\""},
        {"[", "1:1: expected a directive, found '['"},
        {"Translate 1 2\nScale 1 1 1", "2:1: Translate takes 3 numbers: expected number 3, found 'Scale'"},
        {"Translate 1 2", "1:14: Translate takes 3 numbers: expected number 3, found the end of the file"},
        {"Translate 1 2 3x", "1:15: Translate takes 3 numbers: expected number 3, found '3x'"},
        {"Transform [1 2 3", "1:17: Transform takes 16 numbers"},
        {"Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 7]",
         "1:44: Transform in line 1 takes 16 numbers: expected ']'"},
        {"Camera perspective", "1:8: expected a type in quotes, found 'perspective'"},
        {"Camera \"perspective", "1:8: this string has no closing quote"},
        {"Camera \"perspective\" \"float\" 3", "1:22: expected a parameter \"type name\", found \"float\""},
        {"Camera \"perspective\" \"float fov x\" 3", "1:22: expected a parameter \"type name\""},
        {"Camera \"perspective\" \"flute fov\" 3", "1:22: unknown parameter type 'flute'"},
        {"Camera \"perspective\" \"float fov\"", "1:33: parameter \"fov\": expected a number, found the end"},
        {"Camera \"perspective\" \"float fov\" [3", "1:34: this '[' has no ']'"},
        {"Camera \"perspective\" \"float fov\" [3 [",
         "1:37: parameter \"fov\": expected a number, found '['"},
        {"Camera \"perspective\" \"float fov\" \"40\"",
         "1:34: parameter \"fov\": expected a number, found \"40\""},
        {"Camera \"perspective\" \"float fov\" [40 50]", "1:22: parameter \"fov\" takes one value, found 2"},
        {"Camera \"perspective\" \"float fov\" []", "1:22: parameter \"fov\" takes one value, found 0"},
        {"Camera \"perspective\" \"integer fov\" 40",
         "1:22: parameter \"fov\" must be of type float, not integer"},
        {"Camera \"perspective\" \"float fov\" 40 \"float fov\" 41",
         "1:37: parameter \"fov\" is given twice"},
        {"Camera \"perspective\" \"float fov\" nan",
         "1:34: parameter \"fov\": expected a number, found 'nan'"},
        {"Film \"rgb\" \"bool savefp16\" maybe",
         "1:28: parameter \"savefp16\": expected true or false, found 'maybe'"},
        {"Film \"rgb\" \"string filename\" 7",
         "1:30: parameter \"filename\": expected a quoted string, found '7'"},
        {"Film \"rgb\" \"integer xresolution\" 64.5",
         "1:12: parameter \"xresolution\" is 64.5, but must be an integer"},
        {"Film \"rgb\" \"integer xresolution\" 0",
         "1:12: parameter \"xresolution\" is 0, but must be an integer from 1"},
        {"Film \"rgb\" \"integer xresolution\" 1e30",
         "1:12: parameter \"xresolution\" is 1e+30, but must be"},
        {"Film \"rgb\" \"integer xresolution\" 30000 \"integer yresolution\" 30000",
         "1:1: 30000 x 30000 pixels are more than the limit"},
        {"Film \"rgb\" \"string filename\" \"a\\qb\"", "1:30: unknown escape \\q"},
    };
    EXPECT_ERRORS(cases);
}

static void directives_in_the_wrong_place_are_refused(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {"Shape \"sphere\"", "1:1: Shape must come after WorldBegin"},
        {"WorldBegin\nCamera \"perspective\"", "2:1: Camera must come before WorldBegin"},
        {"WorldBegin\nWorldBegin", "2:1: a second WorldBegin"},
        {"WorldBegin\nAttributeEnd", "2:1: AttributeEnd without AttributeBegin"},
        {"WorldBegin\nAttributeBegin\nObjectEnd", "3:1: ObjectEnd outside of an object"},
        {"WorldBegin\nObjectBegin \"a\"\nAttributeBegin\nObjectEnd",
         "4:1: ObjectEnd, but the innermost open block is the AttributeBegin of line 3"},
        {"WorldBegin\n AttributeBegin\n", "2:2: this block is never closed"},
        {"WorldBegin\nAttributeBegin\nWorldEnd", "3:1: WorldEnd, but the block of line 2 is still open"},
        {"WorldBegin\nObjectBegin \"a\"\nObjectBegin \"b\"", "3:1: an object inside an object"},
        {"WorldBegin\nObjectBegin \"a\" ObjectEnd\nObjectBegin \"a\"",
         "3:1: the object \"a\" has been defined before"},
        {"WorldBegin\nObjectInstance \"a\"", "2:1: no object \"a\" has been defined before"},
        {"WorldBegin\nObjectBegin \"a\"\nShape \"sphere\"\nObjectEnd\nScale 1 1e-11 1\nObjectInstance \"a\"",
         "6:1: the current transform is close to singular, or scales to less than 1e-10"},
        {"WorldBegin\nObjectBegin \"a\"\n ObjectInstance \"a\"", "3:2: an instance inside an object"},
        {"WorldBegin\nNamedMaterial \"a\" Shape \"sphere\"", "2:1: there is no MakeNamedMaterial \"a\""},
        {"WorldBegin\nMakeNamedMaterial \"a\"", "2:1: MakeNamedMaterial needs a parameter \"string type\""},
        {"WorldBegin\nMakeNamedMaterial \"a\" \"string type\" \"diffuse\"\nMakeNamedMaterial \"a\" \"string "
         "type\" "
         "\"diffuse\"",
         "3:1: the material \"a\" has been made before, in line 2"},
        {"Film \"rgb\"\nFilm \"rgb\"", "2:1: a second Film; the first, in line 1"},
        {"CoordSysTransform \"x\"", "1:1: no CoordinateSystem \"x\""},
        {"Scale 1 0 1", "1:1: the current transform becomes singular"},
        {"Rotate 3 0 0 0", "1:1: the axis of this Rotate has no direction"},
        {"LookAt 0 0 0 0 0 0 0 1 0", "1:1: this LookAt has no direction"},
        {"TransformTimes 0 1\nWorldBegin\nActiveTransform EndTime\nScale 1 1 -1\nShape \"sphere\"",
         "5:1: what moves from a transform to its mirror image"},
        {"Transform [1 0 0 0 0 1 0 0 0 0 0 0 0 0 0 1]", "1:1: the current transform becomes singular"},
        {"Transform [1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1]", "1:1: Transform: not an affine transform"},
        {"ActiveTransform Some", "1:17: expected All, StartTime or EndTime, found 'Some'"},
        {"Include \"none.pbrt\"", "1:1: "},
        {"Include \"s.pbrt\"", "1:1: "},
        {"Import \"x.pbrt\"", "1:1: Import must come after WorldBegin"},
        {"MakeNamedMedium \"a\" \"string type\" \"nanovdb\"\nWorldBegin\nMediumInterface \"a\" \"\"\nShape "
         "\"sphere\"",
         "1:1: a nanovdb medium needs its file: \"string filename\""},
        {"ColorSpace \"wurst\"", "1:1: "},
        {"Attribute \"wurst\"", "1:1: Attribute \"wurst\": shape, light"},
    };
    EXPECT_ERRORS(cases);
}

static void dialects_are_not_mixed(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {"Film \"image\"\nWorldBegin\nMaterial \"diffuse\"",
         "3:1: material \"diffuse\" is pbrt-v4's, but this scene is pbrt-v3 because of \"image\" in line 1"},
        {"Sampler \"zsobol\"\nWorldBegin\nMaterial \"matte\"",
         "3:1: material \"matte\" is pbrt-v3's, but this scene is pbrt-v4 because of \"zsobol\" in line 1"},
        {"WorldBegin\nMakeNamedMaterial \"a\" \"float x\" 1 \"string type\" [\"matte\"]\nAttribute \"shape\"",
         "3:1: directive \"Attribute\" is pbrt-v4's"},
        {"WorldBegin\nShape \"sphere\" \"bool x\" true\nWorldEnd",
         "2:16: Shape \"sphere\" has no parameter \"bool x\""},
        {"Film \"image\"\nWorldBegin\n", "3:1: the file ends before WorldEnd; is it truncated?"},
        {"WorldBegin\nShape \"cone\"\n", "2:1: shape \"cone\" is pbrt-v3's, but this scene was taken for "
                                         "pbrt-v4 since nothing in it says otherwise"},
    };
    EXPECT_ERRORS(cases);
}

static void what_is_unsupported_is_refused(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {"Camera \"realistic\"", "1:1: the realistic camera needs a \"lensfile\""},
        {"Camera \"wurst\"", "1:1: unknown camera \"wurst\""},
        {"Camera \"perspective\" \"float fov\" 180", "1:22: parameter \"fov\" is 180, but must be from"},
        {"Camera \"perspective\" \"float screenwindow\" [0 1 2]",
         "1:22: parameter \"screenwindow\" takes groups of 4"},
        {"Camera \"perspective\" \"float screenwindow\" [1 0 0 1]", "1:22: screenwindow takes x min"},
        {"PixelFilter \"wurst\"", "1:1: unknown pixel filter \"wurst\""},
        {"PixelFilter \"box\" \"float xradius\" 0", "1:19: parameter \"xradius\" is 0, but must be from"},
        {"Integrator \"path\" \"integer maxdepth\" -1", "1:19: parameter \"maxdepth\" is -1"},
        {"WorldBegin\nLightSource \"wurst\"", "2:1: unknown light \"wurst\""},
        {"WorldBegin\nAreaLightSource \"wurst\"", "2:1: unknown area light \"wurst\""},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"blackbody L\" [6500 1]",
         "2:27: parameter \"L\": a blackbody takes a temperature, found 2 numbers"},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"blackbody L\" -1",
         "2:27: parameter \"L\": the temperature is -1 K"},
        {"WorldBegin\nTexture \"t\" \"spectrum\" \"dots\"\nAreaLightSource \"diffuse\" \"texture L\" \"t\"",
         "3:27: parameter \"L\" cannot vary"},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"rgb L\" [1 -1 1]",
         "2:27: parameter \"L\" must be a colour without"},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"rgb L\" [1 1]",
         "2:27: parameter \"L\" takes three numbers, found 2"},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"spectrum L\" [400 1 700]", "2:27: "},
        {"WorldBegin\nAreaLightSource \"diffuse\" \"spectrum L\" \"none.spd\"", "2:27: "},
        {"WorldBegin\nTexture \"t\" \"int\" \"constant\"",
         "2:1: a Texture is of type \"float\" or \"spectrum\""},
        {"WorldBegin\nShape \"sphere\" \"float radius\" 0", "2:16: the radius is 0"},
        {"WorldBegin\nShape \"sphere\" \"float wurst\" .5",
         "2:16: Shape \"sphere\" has no parameter \"float wurst\""},
    };
    EXPECT_ERRORS(cases);
}

#define USE "\nShape \"sphere\"\n"

static void wrong_materials_are_refused(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {"WorldBegin\nMaterial \"wurst\"" USE, "2:1: unknown material \"wurst\""},
        {"WorldBegin\nMaterial \"kdsubsurface\" \"rgb mfp\" [0 0 0]" USE,
         "2:1: the mean free path below this"},
        {"WorldBegin\nMaterial \"kdsubsurface\" \"float g\" -1" USE, "2:25: g is -1, but must be over -1"},
        {"WorldBegin\nAttribute \"shape\" \"float alpha\" 1\nMaterial \"measured\"" USE,
         "3:1: a measured material needs a \"string filename\""},
        {"WorldBegin\nMaterial \"hair\" \"float beta_n\" -1" USE, "2:17: parameter \"beta_n\" is -1"},
        {"WorldBegin\nMaterial \"hair\" \"float eumelanin\" -1" USE, "2:17: parameter \"eumelanin\" is -1"},
        {"WorldBegin\nMaterial \"hair\" \"float eta\" 0" USE, "2:17: the index of refraction is 0"},
        {"WorldBegin\nMaterial \"hair\" \"rgb sigma_a\" [1 -1 1]" USE, "2:17: parameter \"sigma_a\""},
        {"WorldBegin\nMaterial \"subsurface\" \"rgb sigma_a\" [1 1 1]" USE,
         "2:1: \"sigma_a\" and \"sigma_s\" go together"},
        {"WorldBegin\nMaterial \"subsurface\" \"string name\" \"Wurst\"" USE,
         "2:23: no medium is called \"Wurst\""},
        {"WorldBegin\nMaterial \"subsurface\" \"float scale\" 1e12" USE,
         "2:1: below this surface light would be absorbed or scattered more than 1e+09 times"},
        {"WorldBegin\nMaterial \"disney\" \"rgb scatterdistance\" [1e-20 0 0]" USE,
         "2:1: below this surface light would be absorbed or scattered"},
        {"WorldBegin\nMaterial \"matte\" \"float sigma\" -1" USE, "2:18: parameter \"sigma\" is -1"},
        {"WorldBegin\nMaterial \"matte\" \"float Kd\" 1" USE,
         "2:18: parameter \"Kd\" must be of type rgb, not float"},
        {"WorldBegin\nMaterial \"matte\" \"texture Kd\" \"t\"" USE,
         "2:18: no spectrum Texture \"t\" has been defined before"},
        {"WorldBegin\nTexture \"t\" \"float\" \"constant\"\nMaterial \"matte\" \"texture Kd\" \"t\"" USE,
         "3:18: no spectrum Texture \"t\" has been defined before"},
        {"WorldBegin\nMaterial \"matte\" \"texture bumpmap\" \"t\"" USE,
         "2:18: no float Texture \"t\" has been defined before"},
        {"WorldBegin\nMaterial \"matte\" \"texture Kd\" [\"t\" \"u\"]" USE,
         "2:18: parameter \"Kd\" takes the name of one texture"},
        {"WorldBegin\nMaterial \"glass\" \"float eta\" 0" USE, "2:18: the index of refraction is 0"},
        {"WorldBegin\nMaterial \"metal\" \"float roughness\" -1" USE, "2:18: parameter \"roughness\" is -1"},
        {"WorldBegin\nMaterial \"metal\" \"float roughness\" 99 \"bool remaproughness\" \"false\"" USE,
         "2:18: this roughness makes an alpha of 99"},
        {"WorldBegin\nMaterial \"metal\" \"spectrum eta\" \"Au.eta.spd\"" USE, "2:18: "},
        {"WorldBegin\nMaterial \"dielectric\" \"spectrum eta\" \"glass-none\"" USE, "2:23: "},
        {"WorldBegin\nMaterial \"coatedconductor\" \"float conductor.roughness\" 1000" USE,
         "2:1: this roughness makes an alpha of 31.6"},
        {"WorldBegin\nMaterial \"conductor\" \"rgb reflectance\" [1 1 1] \"rgb k\" [1 1 1]" USE,
         "2:22: a conductor has either \"reflectance\""},
        {"WorldBegin\nMaterial \"diffuse\" \"rgb Kd\" [1 1 1]" USE,
         "2:20: this material has no parameter \"rgb Kd\""},
        {"WorldBegin\nMaterial \"diffuse\" \"texture displacement\" \"t\"" USE,
         "2:20: no float Texture \"t\" has been defined before"},
        {"WorldBegin\nMaterial \"diffuse\" \"string normalmap\" \"none.png\"" USE, "2:20: "},
        {"WorldBegin\nMaterial \"mix\" \"float amount\" 1" USE, "2:1: a mix needs two \"string materials\""},
        {"WorldBegin\nMaterial \"mix\" \"string materials\" [\"a\"]" USE, "2:16: a mix needs two"},
        {"WorldBegin\nMaterial \"mix\" \"string materials\" [\"a\" \"b\"]" USE,
         "2:1: no MakeNamedMaterial \"a\" for this mix"},
        {"WorldBegin\nMakeNamedMaterial \"a\" \"string type\" \"mix\" \"string materials\" [\"a\" \"a\"]\n"
         "NamedMaterial \"a\"" USE,
         "2:1: this mix contains itself"},
        {"WorldBegin\nMakeNamedMaterial \"a\" \"string type\" \"interface\"\nMaterial \"mix\" "
         "\"string materials\" [\"a\" \"a\"]" USE,
         "3:1: a mix with the interface \"a\""},
        {"Film \"image\"\nWorldBegin\nMaterial \"mix\"" USE, "3:1: a mix needs \"string namedmaterial2\""},
    };
    EXPECT_ERRORS(cases);
}

static void mixes_are_not_too_deep(void **state)
{
    (void)state;
    bench_t bench = {0};
    char text[4096],
        *at = text + sprintf(text, "WorldBegin\nMakeNamedMaterial \"m0\" \"string type\" \"diffuse\"\n");
    for (int i = 1; i <= BLOB_MAX_MIX_DEPTH + 1; ++i)
        at += sprintf(
            at, "MakeNamedMaterial \"m%d\" \"string type\" \"mix\" \"string materials\" [\"m%d\" \"m%d\"]\n",
            i, i - 1, i - 1);
    char *end = at;
    sprintf(end, "NamedMaterial \"m%d\"" USE, BLOB_MAX_MIX_DEPTH);
    bench_run(&bench, text);
    bench_expect_ok(&bench);
    sprintf(end, "NamedMaterial \"m%d\"" USE, BLOB_MAX_MIX_DEPTH + 1);
    bench_run(&bench, text);
    expect_text(bench.result.message, "s.pbrt:11:1: mixes are nested deeper than 8");
    bench_close(&bench);
}

#define TEXTURE(kind) "WorldBegin\nTexture \"t\" \"spectrum\" \"" kind "\" "
#define FLOAT_TEXTURE(kind) "WorldBegin\nTexture \"t\" \"float\" \"" kind "\" "

static void wrong_textures_are_refused(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {TEXTURE("wurst"), "2:1: unknown texture \"wurst\""},
        {TEXTURE("ptex"), "2:1: texture \"ptex\" is not supported"},
        {FLOAT_TEXTURE("marble"), "2:1: texture \"marble\" is a colour"},
        {"Film \"image\"\n" FLOAT_TEXTURE("uv"), "3:1: texture \"uv\" is a colour"},
        {TEXTURE("uv"), "2:1: texture \"uv\" is pbrt-v3's"},
        {TEXTURE("dots") "\"float wurst\" 1", "2:31: Texture \"dots\" has no parameter \"float wurst\""},
        {TEXTURE("dots") "\"string mapping\" \"wurst\"", "2:31: unknown mapping \"wurst\""},
        {TEXTURE("dots") "\"string mapping\" \"planar\" \"vector3 v1\" [1 2 3 4 5 6]",
         "2:57: parameter \"v1\" takes three numbers, found 6"},
        {TEXTURE("dots") "\"float uscale\" 1e9", "2:31: parameter \"uscale\" is 1e+09, but must be from"},
        {TEXTURE("dots") "\"texture inside\" \"t\"", "2:31: no spectrum Texture \"t\""},
        {TEXTURE("dots") "\"float inside\" 1", "2:31: parameter \"inside\" must be of type rgb, not float"},
        {TEXTURE("dots") "\"rgb inside\" [1 -1 0]", "2:31: parameter \"inside\" must be a colour without"},
        {TEXTURE("checkerboard") "\"integer dimension\" 4", "2:39: parameter \"dimension\" is 4"},
        {TEXTURE("fbm") "\"integer octaves\" 1000", "2:30: parameter \"octaves\" is 1000"},
        {TEXTURE("directionmix") "\"vector3 dir\" [0 0 0]", "2:39: \"dir\" has no direction"},
        {TEXTURE("imagemap"), "2:1: an imagemap needs its file"},
        {TEXTURE("imagemap") "\"string filename\" \"none.png\"", "2:1: "},
        {TEXTURE("imagemap") "\"string filename\" \"s.pbrt\"", "2:1: "},
        {TEXTURE("imagemap") "\"string filename\" \"s.png\" \"string wrap\" \"x\"",
         "2:61: unknown wrap \"x\""},
        {TEXTURE("imagemap") "\"string filename\" \"s.png\" \"string wrap\" \"octahedralsphere\"",
         "2:61: wrap \"octahedralsphere\" is not supported"},
        {TEXTURE("imagemap") "\"string filename\" \"s.png\" \"string filter\" \"x\"",
         "2:61: unknown filter \"x\""},
        {TEXTURE("imagemap") "\"string filename\" \"s.png\" \"string encoding\" \"gamma 0\"",
         "2:61: unknown encoding \"gamma 0\""},
        {TEXTURE("imagemap") "\"string filename\" \"s.png\" \"string encoding\" \"gamma 2x\"",
         "2:61: unknown encoding \"gamma 2x\""},
    };
    EXPECT_ERRORS(cases);
    bench_t bench = {0};
    bench_run(&bench, TEXTURE("imagemap") "\"string filename\" \"none.png\"");
    expect_text(bench.result.message, "s.pbrt:2:1: ");
    expect_text(bench.result.message, "none.png");
    bench_close(&bench);
}

#define MESH "WorldBegin\nShape \"trianglemesh\" "

static void wrong_meshes_are_refused(void **state)
{
    (void)state;
    static const case_t cases[] = {
        {MESH "\"integer indices\" [0 1 2]", "2:1: a triangle mesh needs vertices"},
        {MESH "\"point3 P\" [0 0 0 1]", "2:22: parameter \"P\" takes groups of 3 numbers, but has 4"},
        {MESH "\"float P\" [0 0 0]", "2:22: a triangle mesh needs vertices: \"point3 P\""},
        {MESH "\"point3 P\" [0 0 0 1 0 0]", "2:1: a mesh of more than three vertices needs"},
        {MESH "\"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 3]",
         "2:53: index number 2 is 3, but must be an integer from 0 to 2"},
        {MESH "\"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 -1 2]", "2:53: index number 1 is -1"},
        {MESH "\"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1]",
         "2:53: parameter \"indices\" takes groups"},
        {MESH "\"point3 P\" [0 0 0 1 0 0 0 1 0] \"normal N\" [0 0 1]", "2:53: 1 normals for 3 vertices"},
        {MESH "\"point3 P\" [0 0 0 1 0 0 0 1 0] \"point2 uv\" [0 0]",
         "2:53: 1 uv coordinates for 3 vertices"},
        {MESH "\"point3 P\" [0 0 0 1e38 0 0 0 1 0]", "2:1: vertex 1 lies at (1e+38 0 0)"},
        {MESH "\"point3 P\" [0 0 0 1e300 0 0 0 1 0]", "2:1: vertex 1 lies at (inf 0 0)"},
    };
    EXPECT_ERRORS(cases);
}

static void wrong_includes_are_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "\n Include \"none.pbrt\"");
    expect_text(bench.result.message, "s.pbrt:2:2: ");
    expect_text(bench.result.message, "none.pbrt cannot be included: No such file");
    const char *back = "\nInclude \"./s.pbrt\"";
    bench_write(&bench, "t.pbrt", back, strlen(back));
    bench_run(&bench, "Include \"t.pbrt\"");
    expect_text(bench.result.message, "t.pbrt:2:1: ");
    expect_text(bench.result.message, "s.pbrt includes itself");
    const char *bad = "\n\n   Wurst";
    bench_write(&bench, "t.pbrt", bad, strlen(bad));
    bench_run(&bench, "Include \"t.pbrt\"");
    expect_text(bench.result.message, "t.pbrt:3:4: unknown directive \"Wurst\"");
    bench_close(&bench);
}

/* Whatever names it: opening a FIFO must not wait for its other end, nor a device be read for ever. */
static void only_regular_files_are_read(void **state)
{
    (void)state;
    static const char *const worlds[] = {
        "WorldBegin\nInclude \"%s\"\nWorldEnd\n",
        "WorldBegin\nShape \"plymesh\" \"string filename\" \"%s\"\nWorldEnd\n",
        "WorldBegin\nTexture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"%s\"\n"
        "Material \"matte\" \"texture Kd\" \"t\"\n" TRIANGLE "WorldEnd\n",
        "WorldBegin\nLightSource \"infinite\" \"string mapname\" \"%s\"\nWorldEnd\n",
        "WorldBegin\nMaterial \"matte\" \"spectrum Kd\" \"%s\"\n" TRIANGLE "WorldEnd\n"};
    bench_t bench = {0};
    char *fifos[] = {bench_path(&bench, "fifo.png"),
                     bench_path(&bench, "fifo.ply"),
                     bench_path(&bench, "fifo.exr"),
                     bench_path(&bench, "fifo.blob"),
                     "/dev/zero",
                     "/"};
    for (int i = 0; i < 4; i++) assert_int_equal(mkfifo(fifos[i], 0600), 0);
    for (size_t i = 0; i < ARRAY_LENGTH(worlds) * ARRAY_LENGTH(fifos); i++) {
        const char *path = fifos[i % ARRAY_LENGTH(fifos)];
        char *text = mem_printf(worlds[i / ARRAY_LENGTH(fifos)], path);
        alarm(20);
        bench_run(&bench, text);
        alarm(0);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, path);
        free(text);
    }
    alarm(20);
    scene_blob_t blob;
    assert_int_equal(blob_open_file(fifos[3], &blob).code, RESULT_INPUT);
    alarm(0);
    for (int i = 0; i < 4; i++) {
        unlink(fifos[i]);
        free(fifos[i]);
    }
    bench_close(&bench);
}

/* Few files may include one another very often. */
static void includes_are_bounded(void **state)
{
    (void)state;
    enum { TIMES = 50 };
    bench_t bench = {0};
    for (char name = 'a'; name <= 'c'; ++name) {
        char text[TIMES * 20 + 1] = "";
        for (int i = 0; i < TIMES; ++i)
            snprintf(text + strlen(text), sizeof text - strlen(text), "Include \"%c.pbrt\"\n", name + 1);
        bench_write(&bench, (char[]){name, '.', 'p', 'b', 'r', 't', 0}, text, strlen(text));
    }
    bench_write(&bench, "d.pbrt", "", 0);
    bench_run(&bench, "Include \"a.pbrt\"");
    expect_text(bench.result.message, " files are included");
    bench_close(&bench);
}

static void unused_parameters_of_v3_are_warnings(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "Film \"image\" \"float wurst\" 1 \"float diagonal\" 35\nWorldBegin\nMaterial \"matte\"\n"
              "  \"rgb Kdd\" [1 1 1]\nAreaLightSource \"diffuse\" \"integer samples\" 4\n" TRIANGLE
              "WorldEnd\nCamera \"perspective\"\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:1:14: unused parameter \"float wurst\" of Film \"image\"");
    expect_text(bench.warnings, "s.pbrt:4:3: unused parameter \"rgb Kdd\" of this material");
    expect_text(bench.warnings, "s.pbrt:5:27: parameter \"samples\" is ignored");
    expect_text(bench.warnings, "s.pbrt:8:1: what follows WorldEnd is ignored");
    assert_int_equal(bench.warning_count, 4);
    bench_close(&bench);
}

static void warnings_are_limited(void **state)
{
    (void)state;
    bench_t bench = {0};
    char *text = mem_zalloc(1, 20000), *s = text + sprintf(text, "WorldBegin\n");
    for (int i = 0; i < 150; ++i) s += sprintf(s, "Shape \"sphere\" \"float wurst\" 1\n");
    sprintf(s, "WorldEnd\n");
    bench_run(&bench, text);
    free(text);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 101);
    expect_text(bench.warnings, "s.pbrt:101:16: unused");
    bench_close(&bench);
}

static void nesting_is_limited(void **state)
{
    (void)state;
    bench_t bench = {0};
    char *text = mem_zalloc(1, 100000), *s = text + sprintf(text, "WorldBegin\n");
    for (int i = 0; i < 1001; ++i) s += sprintf(s, "AttributeBegin\n");
    bench_run(&bench, text);
    expect_text(bench.result.message, "s.pbrt:1002:1: blocks are nested deeper than 1000");

    s = text + sprintf(text, "Camera \"perspective\"");
    for (int i = 0; i < 300; ++i) s += sprintf(s, " \"float p%d\" 1", i);
    bench_run(&bench, text);
    expect_text(bench.result.message, "more than 256 parameters");
    free(text);
    bench_close(&bench);
}

static void files_of_other_formats_are_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "s.dae", "", 0);
    bench_import_file(&bench, "s.dae");
    expect_text(bench.result.message, "s.dae: not a scene format that Lightmill reads");
    bench_import_file(&bench, "none.pbrt");
    expect_text(bench.result.message, "none.pbrt: cannot be opened");
    bench_import(&bench, bench.folder);
    expect_text(bench.result.message, "scene.pbrt: cannot be opened");
    bench_close(&bench);
}

static const char small_v3[] =
    "Scale -1 1 1 LookAt 0 -5 1  0 0 1  0 0 1\nCamera \"perspective\" \"float fov\" [40]\n"
    "Film \"image\" \"integer xresolution\" 8\nSampler \"random\"\nWorldBegin\n"
    "Texture \"t\" \"float\" \"constant\" \"float value\" .5\nAttributeBegin Rotate 3 0 1 0\n"
    "AreaLightSource \"diffuse\" \"rgb L\" [1 2 3] \"bool twosided\" \"true\"\n"
    "MakeNamedMaterial \"m\" \"string type\" \"metal\" \"texture roughness\" \"t\" NamedMaterial "
    "\"m\"\n" TRIANGLE
    "AttributeEnd ObjectBegin \"o\" Shape \"sphere\" ObjectEnd ObjectInstance \"o\"\nWorldEnd";

static void every_truncation_is_an_error(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, small_v3);
    bench_expect_silence(&bench);
    for (size_t size = 0; size < strlen(small_v3); ++size) {
        bench_write(&bench, "s.pbrt", small_v3, size);
        bench_import_file(&bench, "s.pbrt");
        if (bench.result.code != RESULT_INPUT) fail_msg("accepted when cut to %zu bytes", size);
        expect_text(bench.result.message, "s.pbrt:");
    }
    bench_close(&bench);
}

static void random_damage_never_crashes(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char alphabet[] = "\"[]# \n0129.-eTrue\\\001\377ab";
    uint32_t seed = 3;
    for (int round = 0; round < 4000; ++round) {
        char text[sizeof small_v3];
        size_t size = strlen(small_v3);
        memcpy(text, small_v3, size);
        for (int k = 0; k < 1 + round % 5; ++k) {
            seed = seed * 1664525u + 1013904223u;
            text[(seed >> 8) % size] = alphabet[(seed >> 20) % (sizeof alphabet - 1)];
        }
        bench_write(&bench, "s.pbrt", text, size);
        bench_import_file(&bench, "s.pbrt"); /* the blob, if any, has passed blob_open */
    }
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(errors_of_syntax_name_their_place),
        cmocka_unit_test(directives_in_the_wrong_place_are_refused),
        cmocka_unit_test(dialects_are_not_mixed),
        cmocka_unit_test(what_is_unsupported_is_refused),
        cmocka_unit_test(wrong_materials_are_refused),
        cmocka_unit_test(mixes_are_not_too_deep),
        cmocka_unit_test(wrong_textures_are_refused),
        cmocka_unit_test(wrong_meshes_are_refused),
        cmocka_unit_test(wrong_includes_are_refused),
        cmocka_unit_test(only_regular_files_are_read),
        cmocka_unit_test(includes_are_bounded),
        cmocka_unit_test(unused_parameters_of_v3_are_warnings),
        cmocka_unit_test(warnings_are_limited),
        cmocka_unit_test(nesting_is_limited),
        cmocka_unit_test(files_of_other_formats_are_refused),
        cmocka_unit_test(every_truncation_is_an_error),
        cmocka_unit_test(random_damage_never_crashes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
