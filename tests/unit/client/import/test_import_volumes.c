/* What the pbrt importer makes of media that vary: NanoVDB files, written by NanoVDB's own builder, grids of
 * colours, temperatures and clouds; and of files that are damaged. */
#include "tests/unit/client/import/test_import.h"

#include <math.h>

#include "tests/nanovdb_pack.h"

#define POINT_LIGHT "LightSource \"point\"\n"
#define FILE_MEDIUM "MakeNamedMedium \"m\" \"string type\" \"nanovdb\" \"string filename\" \"grid.nvdb\" "

static void run(bench_t *bench, const char *world)
{
    char *text = mem_printf("Film \"rgb\"\nWorldBegin\n" POINT_LIGHT "%s\n", world);
    bench_run(bench, text);
    free(text);
}

static void run_quietly(bench_t *bench, const char *world)
{
    run(bench, world);
    bench_expect_silence(bench);
}

static void expect_error(bench_t *bench, const char *world, const char *message)
{
    run(bench, world);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, message);
}

static const blob_medium_t *medium(const bench_t *bench)
{
    assert_int_equal(count_of(bench, BLOB_SECTION_MEDIA), 1);
    return &bench->blob.media[0];
}

static const blob_field_t *field(const bench_t *bench, blob_ref_t ref)
{
    assert_true(ref > 0 && ref <= count_of(bench, BLOB_SECTION_FIELDS));
    return &bench->blob.fields[ref - 1];
}

/* ---- NanoVDB files --------------------------------------------------------------------------------------
 */

/* A box of numbers with a hole, a part that is even, and next to nothing in a far corner. */
static float some(const void *context, int x, int y, int z)
{
    float scale = context != NULL ? *(const float *)context : 1;
    if (x >= 8 && x < 16 && y >= 0 && y < 8 && z >= -8 && z < 0) return 0.5f * scale;
    if (x == 40 && y == 20 && z == 30) return 3 * scale;
    if (x < -5 || x > 13 || y < -2 || y > 9 || z < -9 || z > 6) return 0;
    if (abs(x - 2) < 3 && abs(y - 3) < 3) return 0;
    return scale * (1 + 0.25f * sinf((float)x) * cosf((float)(y - 2 * z)));
}

static const nanovdb_pack_t pack = {.name = "density",
                                    .low = {-10, -10, -10},
                                    .high = {50, 30, 40},
                                    .at = some,
                                    .voxel = {0.5, 0.25, 2},
                                    .origin = {10, 20, 30}};

static void pack_file(bench_t *bench, const nanovdb_pack_t *grids, size_t count, nanovdb_codec_t codec)
{
    bench_write(bench, "grid.nvdb", "", 0);
    char *path = bench_path(bench, "grid.nvdb");
    assert_true(nanovdb_pack(path, grids, count, codec));
    free(path);
}

static float number_at(const bench_t *bench, const blob_field_t *f, const int at[3])
{
    for (int i = 0; i < 3; ++i)
        if (at[i] < 0 || at[i] >= (int)f->cells[i]) return 0;
    const uint32_t *n = f->cells;
    uint32_t brick =
        bench->blob.bricks[f->first_brick + (uint32_t)(at[0] / 8) +
                           n[0] / 8 * ((uint32_t)(at[1] / 8) + n[1] / 8 * (uint32_t)(at[2] / 8))];
    if (brick == BLOB_NONE) return 0;
    return bench->blob.numbers[f->first + BLOB_BRICK_CELLS * brick + (uint32_t)(at[0] % 8 * 64) +
                               (uint32_t)(at[1] % 8 * 8 + at[2] % 8)];
}

/* All numbers are there, and stand where the file's world has them. `scale` of the world's transform. */
static void expect_numbers(const bench_t *bench, const blob_field_t *f, const nanovdb_pack_t *from,
                           float scale)
{
    const int low[3] = {-5, -2, -9}; /* the box of what is not 0 */
    assert_int_equal(f->kind, FIELD_BRICKS);
    for (int z = from->low[2] - 3; z <= from->high[2]; ++z)
        for (int y = from->low[1] - 3; y <= from->high[1]; ++y)
            for (int x = from->low[0] - 3; x <= from->high[0]; ++x) {
                const int voxel[3] = {x, y, z};
                int at[3];
                for (int i = 0; i < 3; ++i) at[i] = voxel[i] - low[i] + (int)f->origin[i];
                float expected = x <= from->low[0] - 1 ? 0 : some(from->context, x, y, z);
                assert_true(number_at(bench, f, at) == expected);
            }
    for (int k = 0; k < 2; ++k) { /* two corners: the lowest voxel, and one beyond the highest */
        vec3_t corner = xform_point(&f->world_from_field, vec3((float)k, (float)k, (float)k));
        const int high[3] = {41, 21, 31};
        const int *voxel = k == 0 ? low : high;
        double p[3];
        for (int i = 0; i < 3; ++i) p[i] = (double)scale * (from->origin[i] + from->voxel[i] * voxel[i]);
        expect_vec3(corner, p[0], p[1], p[2]);
        for (int i = 0; i < 3; ++i)
            expect_near((double)f->origin[i] + k * (double)f->span[i],
                        voxel[i] - low[i] + (double)f->origin[i], 0);
    }
}

static void a_file_has_its_numbers_and_its_place(void **state)
{
    (void)state;
    for (int codec = NANOVDB_PACK_NONE; codec <= NANOVDB_PACK_BLOSC; ++codec) {
        bench_t bench = {0};
        pack_file(&bench, &pack, 1, (nanovdb_codec_t)codec);
        run_quietly(&bench, "Scale 2 2 2\n" FILE_MEDIUM "\"rgb sigma_a\" [1 2 3] \"rgb sigma_s\" [4 5 6] "
                            "\"float scale\" 2 \"float g\" 0.25\n");
        const blob_medium_t *m = medium(&bench);
        expect_vec3(m->absorption, 2, 4, 6);
        expect_vec3(m->scattering, 8, 10, 12);
        expect_vec3(m->emission, 0, 0, 0);
        expect_near((double)m->g, 0.25, 0);
        assert_int_equal(m->temperature, 0);
        expect_numbers(&bench, field(&bench, m->density), &pack, 2);
        /* what is empty takes no room */
        const blob_field_t *f = field(&bench, m->density);
        assert_true(f->brick_count > 10 && f->brick_count < 40);
        assert_true((uint64_t)f->cells[0] * f->cells[1] * f->cells[2] > 100 * BLOB_BRICK_CELLS);
        bench_close(&bench);
    }
}

/* Leaves, and nodes of them, that have one number: they share a brick. */
static float even(const void *context, int x, int y, int z)
{
    (void)context;
    return x == 200 && y == 0 && z == 0 ? 2 : 7;
}

static void what_is_even_takes_no_room(void **state)
{
    (void)state;
    bench_t bench = {0};
    nanovdb_pack_t block = pack;
    block.at = even;
    block.low[0] = block.low[1] = block.low[2] = 0;
    block.high[0] = 255;
    block.high[1] = block.high[2] = 127;
    pack_file(&bench, &block, 1, NANOVDB_PACK_ZIP);
    run_quietly(&bench, FILE_MEDIUM);
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    assert_int_equal(f->brick_count, 2);
    for (int i = 0; i < 256; ++i) {
        const int at[3] = {i, i / 2, i / 3};
        assert_true(number_at(&bench, f, at) == 7);
    }
    const int odd[3] = {200, 0, 0};
    assert_true(number_at(&bench, f, odd) == 2);
    bench_close(&bench);
}

static void a_file_may_have_several_grids(void **state)
{
    (void)state;
    const float kelvin = 1000;
    bench_t bench = {0};
    nanovdb_pack_t grids[3] = {pack, pack, pack};
    grids[0].name = "velocity";
    grids[0].sort = NANOVDB_PACK_DOUBLES;
    grids[1].name = "temperature";
    grids[1].context = &kelvin;
    pack_file(&bench, grids, 3, NANOVDB_PACK_BLOSC);
    run_quietly(&bench, FILE_MEDIUM "\"rgb sigma_a\" [1 2 3] \"float Lescale\" 4\n");
    const blob_medium_t *m = medium(&bench);
    expect_numbers(&bench, field(&bench, m->density), &pack, 1);
    expect_numbers(&bench, field(&bench, m->temperature), &grids[1], 1);
    expect_vec3(m->emission, 4, 8, 12);
    expect_near((double)m->coldest, 100, 0);
    expect_near((double)m->hottest, 3000, 0);
    run_quietly(&bench,
                FILE_MEDIUM "\"string gridname\" \"temperature\" \"string temperaturename\" \"none\"\n");
    expect_numbers(&bench, field(&bench, medium(&bench)->density), &grids[1], 1);
    assert_int_equal(medium(&bench)->temperature, 0);
    expect_error(&bench, FILE_MEDIUM "\"string gridname\" \"velocity\"\n",
                 "the grid \"velocity\" is not of floats (its type has the number 2); export it so");
    expect_error(&bench, FILE_MEDIUM "\"string gridname\" \"heat\"\n",
                 "grid.nvdb: there is no grid \"heat\", or it has no active voxels");
    bench_close(&bench);
}

/* (t - offset) scale is in kelvin. */
static void temperatures_are_moved_and_scaled(void **state)
{
    (void)state;
    bench_t bench = {0};
    nanovdb_pack_t grids[2] = {pack, pack};
    grids[1].name = "temperature";
    pack_file(&bench, grids, 2, NANOVDB_PACK_NONE);
    run_quietly(&bench, FILE_MEDIUM "\"float temperatureoffset\" 0.5 \"float temperaturescale\" 1000\n");
    const blob_medium_t *m = medium(&bench);
    expect_near((double)m->coldest, 0.6, 1e-6);
    expect_near((double)m->hottest, 3, 0);
    const float *hottest = bench.blob.numbers + m->first_glow + 3 * (BLOB_GLOW_STEPS - 1);
    /* Planck's law at 2500 K, its largest value 1, times the observer's y, all wavelengths added up */
    expect_near(0.212671 * (double)hottest[0] + 0.71516 * (double)hottest[1] + 0.072169 * (double)hottest[2],
                20.6, 0.1);
    assert_true(hottest[0] > hottest[1] && hottest[1] > hottest[2]);
    run_quietly(&bench, FILE_MEDIUM "\"float temperaturecutoff\" 2.95 \"float temperaturescale\" 1000\n");
    assert_int_equal(medium(&bench)->temperature, 0); /* nothing is over 100 K */
    expect_vec3(medium(&bench)->emission, 0, 0, 0);
    expect_error(&bench, FILE_MEDIUM "\"float temperaturescale\" 0\n", "temperaturescale must be over 0");
    bench_close(&bench);
}

/* ---- the smoke of pbrt-v3's reference --------------------------------------------------------------------
 */

/* Its densities, and where they stand. */
typedef struct {
    int side;
    float *cells;
    xform_t place;
    rgb_t absorption, scattering;
} smoke_t;

static smoke_t smoke_of(bench_t *bench)
{
    result_t made = import_scene_blob("scenes/smoke", NULL, &bench->bytes, &bench->size);
    assert_int_equal(made.code, RESULT_OK);
    assert_int_equal(blob_open(bench->bytes, bench->size, &bench->blob).code, RESULT_OK);
    const blob_medium_t *m = medium(bench);
    const blob_field_t *f = field(bench, m->density);
    smoke_t smoke = {(int)f->cells[0], NULL, f->world_from_field, m->absorption, m->scattering};
    size_t count = (size_t)f->cells[0] * f->cells[1] * f->cells[2];
    smoke.cells = mem_alloc(count * sizeof *smoke.cells);
    memcpy(smoke.cells, bench->blob.numbers + f->first, count * sizeof *smoke.cells);
    bench_close(bench);
    return smoke;
}

static float smoke_at(const void *context, int x, int y, int z)
{
    const smoke_t *smoke = context;
    return smoke->cells[((size_t)z * (size_t)smoke->side + (size_t)y) * (size_t)smoke->side + (size_t)x];
}

static void expect_place(const xform_t *a, const xform_t *b)
{
    for (int i = 0; i < 12; ++i) expect_near((double)a->m[i / 4][i % 4], (double)b->m[i / 4][i % 4], 1e-6);
}

/* The same grid as pbrt-v4 has it, in the scene and in a file, says the same of each place. */
static void smoke_is_the_same_in_all_forms(void **state)
{
    (void)state;
#define PLACE "Translate -1 0.05 -1\nScale 2 2 2\n"
#define COEFFICIENTS "\"rgb sigma_a\" [0.6 0.7 0.9] \"rgb sigma_s\" [2.4 2.3 2.1] "
    bench_t bench = {0};
    smoke_t smoke = smoke_of(&bench);
    int n = smoke.side, count = n * n * n, used = 0, room = 16 * count + 200;
    char *world = mem_alloc((size_t)room);
    used = snprintf(world, (size_t)room,
                    PLACE "MakeNamedMedium \"m\" \"string type\" \"uniformgrid\" " COEFFICIENTS
                          "\"integer nx\" %d \"integer ny\" %d \"integer nz\" %d \"float density\" [",
                    n, n, n);
    for (int i = 0; i < count; ++i)
        used += snprintf(world + used, (size_t)(room - used), "%.9g ", (double)smoke.cells[i]);
    snprintf(world + used, (size_t)(room - used), "]\n");
    run_quietly(&bench, world);
    free(world);
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    assert_memory_equal(bench.blob.numbers + f->first, smoke.cells, (size_t)count * sizeof(float));
    expect_place(&f->world_from_field, &smoke.place);
    expect_vec3(medium(&bench)->absorption, (double)smoke.absorption.x, (double)smoke.absorption.y,
                (double)smoke.absorption.z);

    double side = 1.0 / n;
    nanovdb_pack_t grid = {
        .name = "density", .high = {n - 1, n - 1, n - 1}, .at = smoke_at, .context = &smoke};
    for (int i = 0; i < 3; ++i) {
        grid.voxel[i] = side;
        grid.origin[i] = 0.5 * side; /* voxels stand where cells have their middles */
    }
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    run_quietly(&bench, PLACE FILE_MEDIUM COEFFICIENTS "\n");
    f = field(&bench, medium(&bench)->density);
    expect_vec3(medium(&bench)->scattering, (double)smoke.scattering.x, (double)smoke.scattering.y,
                (double)smoke.scattering.z);
    uint64_t met = 0;
    for (int i = 0; i < count; ++i) {
        const int cell[3] = {i % n, i / n % n, i / (n * n)};
        /* the cell's middle, as a point of the unit cube of the first form, of the world, and as a voxel */
        vec3_t middle = vec3(((float)cell[0] + 0.5f) / (float)n, ((float)cell[1] + 0.5f) / (float)n,
                             ((float)cell[2] + 0.5f) / (float)n);
        xform_t into;
        assert_true(xform_invert(&f->world_from_field, &into));
        vec3_t u = xform_point(&into, xform_point(&smoke.place, middle));
        const float p[3] = {u.x, u.y, u.z};
        int at[3];
        for (int k = 0; k < 3; ++k) {
            float place = f->origin[k] + p[k] * f->span[k];
            at[k] = (int)lrintf(place);
            assert_true(fabsf(place - (float)at[k]) < 1e-3f);
        }
        assert_true(number_at(&bench, f, at) == smoke.cells[i]);
        met += smoke.cells[i] > 0;
    }
    assert_true(met > 100);
    free(smoke.cells);
    bench_close(&bench);
#undef COEFFICIENTS
#undef PLACE
}

/* ---- files that are none --------------------------------------------------------------------------------
 */

static void files_that_are_none_are_errors(void **state)
{
    (void)state;
    static const struct {
        const char *bytes;
        size_t size;
        const char *message;
    } cases[] = {
        {"", 0, "the file is empty"},
        {"NanoVDB0", 8, "the file ends early; is it truncated?"},
        {"some text that is no grid", 25, "this is no NanoVDB file; make one of an OpenVDB file"},
        {"NanoVDB1\0\0\0\4\1\0\0\0", 16, "this is no NanoVDB file"},
        {"NanoVDB0\0\0\0\2\1\0\0\0", 16, "version 16 of NanoVDB is not supported; write it with version 32"},
        {"NanoVDB0\0\0\0\4\1\0\3\0", 16, "no codec is known by the number 3"},
        {"NanoVDB0\0\0\0\4\0\0\0\0", 16, "there is no grid \"density\""},
        {"NanoVDB0\0\0\0\4\1\0\0\0", 16, "the file ends early"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_write(&bench, "grid.nvdb", cases[i].bytes, cases[i].size);
        expect_error(&bench, FILE_MEDIUM "\n", cases[i].message);
        expect_text(bench.result.message, "s.pbrt:4:45: ");
        expect_text(bench.result.message, "grid.nvdb: ");
    }
    expect_error(&bench, "MakeNamedMedium \"m\" \"string type\" \"nanovdb\"\n",
                 "s.pbrt:4:1: a nanovdb medium needs its file: \"string filename\"");
    bench_close(&bench);
}

static void a_missing_file_is_empty_space_where_that_is_allowed(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(&bench, FILE_MEDIUM "\n", "grid.nvdb: ");
    bench.lenient = true;
    run(&bench, FILE_MEDIUM "\"float g\" 0.5\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "the medium is empty space");
    expect_vec3(medium(&bench)->absorption, 0, 0, 0);
    expect_vec3(medium(&bench)->scattering, 0, 0, 0);
    bench_close(&bench);
}

static float strange(const void *context, int x, int y, int z)
{
    return x == 3 && y == 3 && z == 3 ? *(const float *)context : 1;
}

static void numbers_that_no_density_has_are_errors(void **state)
{
    (void)state;
    static const float values[] = {NAN, INFINITY, 2e9f, -2e9f};
    bench_t bench = {0};
    nanovdb_pack_t grid = pack;
    grid.at = strange;
    for (size_t i = 0; i < ARRAY_LENGTH(values); ++i) {
        grid.context = &values[i];
        pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
        expect_error(&bench, FILE_MEDIUM "\n",
                     "grid.nvdb: a number of the grid \"density\" is not finite, or over 1e+09; repair it");
    }
    const float minus = -0.25f;
    grid.context = &minus;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    expect_error(&bench, FILE_MEDIUM "\n", "grid.nvdb: the grid \"density\" has negative numbers");
    bench.lenient = true;
    run(&bench, FILE_MEDIUM "\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "they are taken for 0");
    const int at[3] = {16 - 10 + 3 + 0, 9 + 4 - 0, 13}; /* low is -10, its brick begins at -16 */
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    assert_true(f->origin[0] == 6);
    const int there[3] = {19, 19, 19};
    assert_true(number_at(&bench, f, there) == 0 && number_at(&bench, f, at) == 1);
    bench_close(&bench);
}

/* Two corners about 0, where the tree's largest nodes meet: the other six are what surrounds them. */
static float two_corners(const void *context, int x, int y, int z)
{
    (void)context;
    return (x < 0) == (y < 0) && (y < 0) == (z < 0) ? 1 : 2;
}

static void what_surrounds_a_grid_fills_its_box(void **state)
{
    (void)state;
    bench_t bench = {.lenient = true};
    nanovdb_pack_t grid = pack;
    grid.at = two_corners;
    grid.background = 2;
    for (int i = 0; i < 3; ++i) {
        grid.low[i] = -3;
        grid.high[i] = 2;
    }
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    run(&bench, FILE_MEDIUM "\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "surrounded by the number 2; outside of its box it is taken for 0");
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    for (int i = 0; i < 8; ++i) {
        const int at[3] = {i & 1 ? 9 : 6, i & 2 ? 9 : 6, i & 4 ? 9 : 6}; /* 0 is at 8 */
        assert_true(number_at(&bench, f, at) == (i == 0 || i == 7 ? 1 : 2));
    }
    bench_close(&bench);
}

static void grids_that_are_no_density_are_errors(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Film \"rgb\" \"float iso\" 1e7\nWorldBegin\n" POINT_LIGHT
                      "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"rgb Le\" [1e5 1 1]\n");
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, "what a medium emits, times the film's exposure, is over 1e9");
    nanovdb_pack_t grid = pack;
    grid.sort = NANOVDB_PACK_LEVEL_SET;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    expect_error(&bench, FILE_MEDIUM "\n", "the grid \"density\" is not a fog volume");
    grid = pack;
    grid.background = 2;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    expect_error(&bench, FILE_MEDIUM "\n", "the grid \"density\" is surrounded by the number 2");
    grid = pack;
    grid.voxel[1] = 0;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    expect_error(&bench, FILE_MEDIUM "\n", "the box of this medium's grid");
    bench_close(&bench);
}

/* Only two voxels, far from each other. */
static float far_apart(const void *context, int x, int y, int z)
{
    (void)y, (void)z;
    int other = *(const int *)context;
    return x == 0 || x == other ? 1 : 0;
}

static void boxes_that_are_too_large_are_errors(void **state)
{
    (void)state;
    bench_t bench = {0};
    nanovdb_pack_t grid = pack;
    int other = 5000;
    grid.at = far_apart;
    grid.context = &other;
    grid.low[0] = grid.low[1] = grid.low[2] = grid.high[1] = grid.high[2] = 0;
    grid.high[0] = 5000;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    expect_error(&bench, FILE_MEDIUM "\n",
                 "the grid \"density\" has 5001 voxels along an axis, over the limit of 4088");
    other = grid.high[0] = 4000;
    pack_file(&bench, &grid, 1, NANOVDB_PACK_NONE);
    run_quietly(&bench, FILE_MEDIUM "\n");
    bench_close(&bench);
}

/* Wherever a file is cut, and whatever a byte of it becomes, nothing but an import or an error comes of it.
 */
static void damaged_files_are_survived(void **state)
{
    (void)state;
    bench_t bench = {0};
    nanovdb_pack_t grid = pack;
    grid.high[0] = grid.high[1] = grid.high[2] = 10;
    for (int codec = NANOVDB_PACK_NONE; codec <= NANOVDB_PACK_BLOSC; ++codec) {
        pack_file(&bench, &grid, 1, (nanovdb_codec_t)codec);
        char *path = bench_path(&bench, "grid.nvdb");
        uint8_t *bytes;
        size_t size;
        assert_int_equal(file_read(path, SIZE_MAX / 2, &bytes, &size).code, RESULT_OK);
        for (size_t i = 0; i < 20; ++i) {
            bench_write(&bench, "grid.nvdb", bytes, i < 10 ? i * size / 10 : i * 16);
            expect_error(&bench, FILE_MEDIUM "\n", "grid.nvdb: ");
        }
        const size_t head = 16 + 176 + 8, steps = codec == NANOVDB_PACK_BLOSC ? 40 : 300;
        for (size_t i = 0; i < steps; ++i) {
            size_t at = i < steps / 2 ? i * (head + 1200) / (steps / 2) : i * 7919 % size;
            bytes[at] ^= 0xFF;
            bench_write(&bench, "grid.nvdb", bytes, size);
            run(&bench, FILE_MEDIUM "\n");
            assert_true(bench.result.code == RESULT_OK || bench.result.code == RESULT_INPUT);
            bytes[at] ^= 0xFF;
        }
        free(bytes);
        free(path);
    }
    bench_close(&bench);
}

/* A few bytes of ZIP that say they become a terabyte. */
static void sizes_that_cannot_be_are_errors(void **state)
{
    (void)state;
    bench_t bench = {0};
    pack_file(&bench, &pack, 1, NANOVDB_PACK_ZIP);
    char *path = bench_path(&bench, "grid.nvdb");
    uint8_t *bytes;
    size_t size;
    assert_int_equal(file_read(path, SIZE_MAX / 2, &bytes, &size).code, RESULT_OK);
    bytes[16 + 5] = 1;
    bench_write(&bench, "grid.nvdb", bytes, size);
    expect_error(&bench, FILE_MEDIUM "\n", "bytes cannot become the");
    free(bytes);
    free(path);
    bench_close(&bench);
}

/* ---- grids ----------------------------------------------------------------------------------------------
 */

#define GRID                                                                                                 \
    "MakeNamedMedium \"m\" \"string type\" \"uniformgrid\" \"integer nx\" 2 \"float density\" [1 2] "        \
    "\"rgb sigma_a\" [1 2 3] "

static void a_grid_may_glow_more_here_than_there(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, GRID "\"rgb Le\" [5 6 7] \"float Lescale\" [4 5]\n");
    expect_vec3(medium(&bench)->emission, 5, 12, 21);
    const blob_field_t *f = field(&bench, medium(&bench)->emission_tint);
    assert_true(f->cells[0] == 2 && f->channels == 1);
    assert_true(bench.blob.numbers[f->first] == 4 && bench.blob.numbers[f->first + 1] == 5);
    expect_error(
        &bench, GRID "\"rgb Le\" [5 6 7] \"float Lescale\" [4 4 4]\n",
        "s.pbrt:4:125: 3 numbers of \"Lescale\" for a grid of nx x ny x nz = 2 x 1 x 1 cells; give 2");
    expect_error(&bench, GRID "\"rgb Le\" [5 6 7] \"float Lescale\" [4 -4]\n",
                 "Lescale number 1 is -4, but must be from 0");
    run_quietly(&bench, GRID "\"float Lescale\" [4 5]\n"); /* of what does not glow */
    assert_int_equal(medium(&bench)->emission_tint, 0);
    bench_close(&bench);
}

static void a_grid_may_have_temperatures(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, GRID "\"float temperature\" [1000 2000] \"float Lescale\" [4 5]\n");
    const blob_medium_t *m = medium(&bench);
    expect_vec3(m->emission, 1, 2, 3);
    expect_near((double)m->hottest, 2000, 0);
    const blob_field_t *f = field(&bench, m->temperature);
    assert_true(bench.blob.numbers[f->first] == 1000 && bench.blob.numbers[f->first + 1] == 2000);
    assert_int_equal(field(&bench, m->emission_tint)->cells[0], 2);
    expect_error(&bench, GRID "\"float temperature\" [1000 2000 1]\n", "3 temperatures for a grid of");
    expect_error(&bench, GRID "\"float temperature\" [1000 -2]\n", "temperature number 1 is -2");
    expect_error(&bench, GRID "\"float temperature\" [1000 2000] \"rgb Le\" [1 1 1]\n",
                 "a medium emits by either \"Le\" or \"temperature\", not both");
    bench_close(&bench);
}
#undef GRID

#define RGB "MakeNamedMedium \"m\" \"string type\" \"rgbgrid\" \"integer ny\" 2 \"float scale\" 3 "

static void a_grid_may_have_colours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, RGB "\"rgb sigma_a\" [1 2 3 4 5 6] \"rgb sigma_s\" [.1 .2 .3 .4 .5 .6] \"rgb Le\" "
                            "[6 5 4 3 2 1] \"float Lescale\" 2 \"float g\" 0.5 \"point3 p1\" [2 2 2]\n");
    const blob_medium_t *m = medium(&bench);
    const blob_field_t *a = field(&bench, m->absorption_tint), *s = field(&bench, m->scattering_tint),
                       *e = field(&bench, m->emission_tint);
    assert_int_equal(m->density, 0);
    assert_true(a->channels == 3 && a->cells[0] == 1 && a->cells[1] == 2);
    expect_vec3(xform_point(&a->world_from_field, vec3(1, 1, 1)), 2, 2, 2);
    for (uint32_t i = 0; i < 6; ++i) {
        expect_near((double)bench.blob.numbers[a->first + i], i + 1, 1e-5);
        expect_near((double)bench.blob.numbers[s->first + i], 0.1 * (i + 1), 1e-6);
        expect_near((double)bench.blob.numbers[e->first + i], 6.0 - i, 1e-5);
    }
    expect_vec3(m->absorption, 3, 3, 3);
    expect_vec3(m->scattering, 3, 3, 3);
    expect_near((double)m->emission.x, 6 * 106.856895, 1e-3);
    expect_near((double)m->g, 0.5, 0);
    run_quietly(&bench, RGB "\"rgb sigma_s\" [1 2 3 4 5 6]\n");
    assert_int_equal(medium(&bench)->absorption_tint, 0);
    expect_error(&bench, RGB "\n", "an rgbgrid needs colours");
    expect_error(&bench, RGB "\"rgb sigma_s\" [1 2 3]\n", "1 colours for a grid of nx x ny x nz = 1 x 2 x 1");
    expect_error(&bench, RGB "\"rgb sigma_s\" [1 2 3 4 5 -6]\n",
                 "colour number 1 of \"sigma_s\" is (4 5 -6)");
    expect_error(&bench, RGB "\"rgb sigma_s\" [1 2 3 4 5 6] \"rgb Le\" [1 2 3 4 5 6]\n",
                 "an rgbgrid with \"Le\" needs \"sigma_a\"");
    bench_close(&bench);
}
#undef RGB

/* pbrt-v4 sorts the corners of a box; pbrt-v3 mirrors what is in it. */
static void a_box_begins_at_its_least_corner(void **state)
{
    (void)state;
    bench_t bench = {0};
#define CORNERS(point)                                                                                       \
    "\"integer nx\" 2 \"float density\" [1 0] \"" point " p0\" [3 0 0] \"" point " p1\" [1 1 1]\n"
    run_quietly(&bench, "MakeNamedMedium \"m\" \"string type\" \"uniformgrid\" " CORNERS("point3"));
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    expect_vec3(xform_point(&f->world_from_field, vec3(0, 0, 0)), 1, 0, 0);
    expect_vec3(xform_point(&f->world_from_field, vec3(1, 1, 1)), 3, 1, 1);
    bench_run_v3(&bench,
                 "WorldBegin\n" POINT_LIGHT
                 "MakeNamedMedium \"m\" \"string type\" \"heterogeneous\" " CORNERS("point") "WorldEnd\n");
    bench_expect_ok(&bench);
    f = field(&bench, medium(&bench)->density);
    expect_vec3(xform_point(&f->world_from_field, vec3(0, 0, 0)), 3, 0, 0);
    bench_close(&bench);
}

#define CLOUD "MakeNamedMedium \"m\" \"string type\" \"cloud\" "

static void a_cloud_has_its_parameters(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, CLOUD "\n");
    const blob_field_t *f = field(&bench, medium(&bench)->density);
    assert_int_equal(f->kind, FIELD_CLOUD);
    assert_true(f->parameters[0] == 1 && f->parameters[1] == 1 && f->parameters[2] == 5);
    run_quietly(&bench,
                "Translate 1 0 0\n" CLOUD
                "\"float density\" 2 \"float wispiness\" 3 \"float frequency\" 4 \"point3 p0\" [-1 0 1] "
                "\"point3 p1\" [2 1 3] \"rgb sigma_s\" [7 8 9] \"float g\" 0.5\n");
    f = field(&bench, medium(&bench)->density);
    assert_true(f->parameters[0] == 2 && f->parameters[1] == 3 && f->parameters[2] == 4);
    assert_true(f->origin[0] == -1 && f->span[0] == 3 && f->origin[2] == 1 && f->span[2] == 2);
    expect_vec3(xform_point(&f->world_from_field, vec3(0, 0, 0)), 0, 0, 1);
    expect_vec3(medium(&bench)->scattering, 7, 8, 9);
    expect_error(&bench, CLOUD "\"float density\" -1\n", "parameter \"density\" is -1, but must be from 0");
    run_quietly(&bench, CLOUD "\"point3 p1\" [-1 1 1]\n"); /* corners are sorted */
    f = field(&bench, medium(&bench)->density);
    assert_true(f->origin[0] == -1 && f->span[0] == 1 && f->origin[1] == 0);
    expect_error(&bench, CLOUD "\"point3 p1\" [1e7 1 1]\n", "p0 and p1 must differ by at least 1e-6");
    bench_close(&bench);
}
#undef CLOUD

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_file_has_its_numbers_and_its_place),
        cmocka_unit_test(what_is_even_takes_no_room),
        cmocka_unit_test(a_file_may_have_several_grids),
        cmocka_unit_test(temperatures_are_moved_and_scaled),
        cmocka_unit_test(smoke_is_the_same_in_all_forms),
        cmocka_unit_test(files_that_are_none_are_errors),
        cmocka_unit_test(a_missing_file_is_empty_space_where_that_is_allowed),
        cmocka_unit_test(numbers_that_no_density_has_are_errors),
        cmocka_unit_test(what_surrounds_a_grid_fills_its_box),
        cmocka_unit_test(grids_that_are_no_density_are_errors),
        cmocka_unit_test(boxes_that_are_too_large_are_errors),
        cmocka_unit_test(damaged_files_are_survived),
        cmocka_unit_test(sizes_that_cannot_be_are_errors),
        cmocka_unit_test(a_grid_may_glow_more_here_than_there),
        cmocka_unit_test(a_grid_may_have_temperatures),
        cmocka_unit_test(a_grid_may_have_colours),
        cmocka_unit_test(a_box_begins_at_its_least_corner),
        cmocka_unit_test(a_cloud_has_its_parameters),
    };
    return cmocka_run_group_tests_name("import_volumes", tests, NULL, NULL);
}
