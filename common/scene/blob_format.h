/* blob_format: the records that a scene blob is made of (see scene_blob.h): what is written there is the
 * format. A record with a new meaning takes a new BLOB_VERSION. */
#ifndef LIGHTMILL_BLOB_FORMAT_H
#define LIGHTMILL_BLOB_FORMAT_H

#include "common/vec.h"

#include <stddef.h>
#include <stdint.h>

enum { BLOB_VERSION = 8 };
#define BLOB_NONE 0xFFFFFFFFu
#define BLOB_MAX_BYTES ((uint64_t)1 << 36)
/* Of the numbers of tables and fields, and of the coefficients of media: so that no sum of products
 * overflows. */
#define BLOB_MAX_NUMBER 1e9
enum {
    BLOB_MAX_IMAGE_SIDE = 65536,
    BLOB_BAND_ROWS = 32,          /* of an image; 32 x 32 pixels of 4 bytes are a page of memory */
    BLOB_MAX_TEXTURE_COST = 1000, /* textures that one look-up evaluates */
    BLOB_MAX_MIX_DEPTH = 8,       /* mixes of mixes */
    BLOB_MAX_STEPS = 129,         /* times at which a mesh is given; Embree's most */
    LENS_MAX_ELEMENTS = 100,
    LENS_PUPILS = 64,
    BLOB_MAX_FOURIER_NODES = 1024,
    BLOB_MAX_FOURIER_ORDER = 16384, /* terms of a series */
    BLOB_MAX_MEASURED_SIDE = 4096,
    BLOB_MAX_GRID_SIDE = 4096, /* of a field, in cells */
    BLOB_BRICK_SHIFT = 3,
    BLOB_BRICK_SIDE = 1 << BLOB_BRICK_SHIFT,
    BLOB_BRICK_CELLS = BLOB_BRICK_SIDE * BLOB_BRICK_SIDE * BLOB_BRICK_SIDE,
    BLOB_GLOW_STEPS = 1024,    /* colours of black bodies */
    BLOB_SPECTRUM_FIRST = 360, /* nm */
    BLOB_SPECTRUM_STEP = 5,
    BLOB_SPECTRUM_SAMPLES = 95
};

typedef enum {
    BLOB_SECTION_SCENE,        /* blob_scene_t, exactly one */
    BLOB_SECTION_POSITIONS,    /* vec3_t, object space of the shape's object */
    BLOB_SECTION_NORMALS,      /* vec3_t, unit length, same space; tangents as well */
    BLOB_SECTION_UVS,          /* vec2_t */
    BLOB_SECTION_COLOURS,      /* blob_colour_t */
    BLOB_SECTION_TRIANGLES,    /* blob_triangle_t */
    BLOB_SECTION_MESHES,       /* blob_mesh_t */
    BLOB_SECTION_QUADRICS,     /* blob_quadric_t */
    BLOB_SECTION_CURVE_POINTS, /* blob_curve_point_t */
    BLOB_SECTION_CURVES,       /* blob_curves_t */
    BLOB_SECTION_SHAPES,       /* blob_shape_t, grouped by object */
    BLOB_SECTION_OBJECTS,      /* blob_object_t; object 0 is the world */
    BLOB_SECTION_INSTANCES,    /* blob_instance_t, all in the world */
    BLOB_SECTION_TEXTURES,     /* blob_texture_t; each refers only to those before it */
    BLOB_SECTION_IMAGES,       /* blob_image_t */
    BLOB_SECTION_TEXELS,       /* 32-bit words, the pixels of the images */
    BLOB_SECTION_MATERIALS,    /* blob_material_t; a mix refers only to materials before it */
    BLOB_SECTION_MEDIA,        /* blob_medium_t */
    BLOB_SECTION_FIELDS,       /* blob_field_t */
    BLOB_SECTION_BRICKS,       /* uint32_t, where the bricks of the fields lie */
    BLOB_SECTION_LIGHTS,       /* blob_light_t */
    BLOB_SECTION_LENS,         /* blob_lens_element_t, of CAMERA_REALISTIC, from the scene to the film */
    BLOB_SECTION_PUPILS,       /* blob_pupil_t, LENS_PUPILS of CAMERA_REALISTIC, else none */
    BLOB_SECTION_FOURIERS,     /* blob_fourier_t */
    BLOB_SECTION_SERIES,       /* blob_series_t */
    BLOB_SECTION_MEASUREMENTS, /* blob_measured_t */
    BLOB_SECTION_NUMBERS,      /* float, of the tables of BSDFs and of media; at most 1e9 in size */
    BLOB_SECTION_SPECTRA,      /* blob_spectrum_t */
    BLOB_SECTION_STRINGS,      /* char, NUL-terminated names; offset 0 is the empty string */
    BLOB_SECTION_COUNT
} blob_section_t;

/* A reference that may be absent: 0 for none, else 1 + an index. */
typedef uint32_t blob_ref_t;

/* ---- the scene ----------------------------------------------------------------------------------------- */

typedef enum {
    FILTER_BOX = 1,
    FILTER_TRIANGLE = 2,
    FILTER_GAUSSIAN = 3, /* parameters: sigma in pixels */
    FILTER_MITCHELL = 4, /* parameters: B, C */
    FILTER_SINC = 5      /* parameters: tau, the radius of the Lanczos window in lobes */
} filter_kind_t;

typedef struct {
    uint32_t kind;  /* filter_kind_t */
    float radius_x; /* pixels; 0.5 for a box that is the pixel itself */
    float radius_y;
    float parameters[2]; /* as filter_kind_t says */
} blob_filter_t;

typedef enum {
    CAMERA_PERSPECTIVE = 1,  /* pinhole or thin lens */
    CAMERA_ORTHOGRAPHIC = 2, /* screen window in units of camera space; with a lens it is telecentric: through
                                each of its points pass parallel rays */
    CAMERA_SPHERICAL = 3,  /* latitude-longitude: film y is the angle from camera +y, film x the angle about y
                              from +x towards +z (pbrt-v3's environment camera) */
    CAMERA_EQUAL_AREA = 4, /* the octahedral equal-area map of pbrt-v4's spherical camera */
    CAMERA_REALISTIC = 5   /* a film at z = 0 behind a lens of elements; the screen window is the film as it
                              shows the scene: upright, in units of camera space */
} camera_kind_t;

/* Camera, filter and what the scene file asks for; the job's settings start from these. */
typedef struct {
    uint32_t camera;               /* camera_kind_t */
    xform_t world_from_camera;     /* camera space: x right, y up, looks down +z, as in pbrt */
    xform_t world_from_camera_end; /* at time 1; equal to world_from_camera when the camera stands still */
    float fov;              /* degrees, along the shorter side of the screen window; perspective alone */
    float lens_radius;      /* 0: all is sharp; perspective and orthographic */
    float focal_distance;   /* of the plane in focus, along z; > 0 */
    float screen_window[4]; /* x min, x max, y min, y max in units of the window with half-height 1; all 0:
                               made from the resolution, the shorter side spanning [-1, 1] */
    float film_window[4];   /* the part of the film that is rendered (a crop): x min, x max, y min, y max as
                               fractions of the screen window from the top left; 0 1 0 1: all of it */
    float lens_exposure;    /* of CAMERA_REALISTIC: a sample through the lens counts this times cos^4 of its
                               angle at the film times the area of the pupil's box */
    blob_ref_t aperture; /* of CAMERA_REALISTIC: an image of TEXELS_R32F, what the stop lets through over the
                            square about it, as seen with x to the right; 0: the stop is round */
    blob_filter_t filter;
    int32_t width, height; /* pixels asked for */
    int32_t max_depth;
    uint32_t spp;
    uint32_t integrator; /* integrator_t */
    uint32_t sampler;    /* sampler_kind_t */
    float max_luminance; /* samples brighter than this are scaled down to it; INFINITY: none. A bias that the
                            scene asks for */
    float occlusion_distance; /* of the integrator ao: what is farther hides nothing; may be INFINITY */
    rgb_t occlusion_radiance; /* what it shows where nothing is hidden */
    uint32_t regularize; /* 1: near-specular lobes are roughened behind the first scattering that is not */
    blob_ref_t medium;   /* the camera stands in it; of the media */
} blob_scene_t;

/* One surface of a lens, in units of camera space. */
typedef struct {
    float curvature_radius; /* positive: the middle lies towards the film; 0: a flat stop, bends nothing */
    float thickness;        /* along the axis, from this surface to the next, or to the film */
    float eta;              /* index of refraction of what follows towards the film; > 0 */
    float aperture_radius;  /* > 0 */
} blob_lens_element_t;

/* A box on the plane through the rear of the lens, which all light passes from it to a piece of the film: the
 * i-th of LENS_PUPILS is of film places on the positive x axis, from i to i + 1 LENS_PUPILS-ths of the film's
 * half diagonal from the middle. For others it is turned with them about the axis. Empty: no light comes. */
typedef struct {
    float x_min, x_max, y_min, y_max;
} blob_pupil_t;

/* ---- shapes -------------------------------------------------------------------------------------------- */

typedef struct {
    float r, g, b, a; /* linear */
} blob_colour_t;

typedef struct {
    uint32_t v[3]; /* relative to the mesh's first vertex */
} blob_triangle_t;

typedef struct {
    uint32_t first_position, vertex_count;
    uint32_t first_normal;    /* BLOB_NONE: flat; else vertex_count normals from here */
    blob_ref_t first_tangent; /* 0: normal maps and anisotropy follow the uvs. Else 1 + the place, among the
                                 normals, of as many tangents as there are normals, then as many bitangents:
                                 what these maps' x and y run along. Where one is (0,0,0), the uvs count */
    uint32_t steps;     /* 0: still. Else 2 or more: its positions, normals and tangents are given at so many
                           times, evenly from 0 to 1, one set behind the other; in between they move in
                           straight lines. Such a mesh does not emit */
    uint32_t first_uv;  /* BLOB_NONE: pbrt's (0,0) (1,0) (1,1) in every triangle */
    uint32_t first_uv2; /* a second set of uvs, or BLOB_NONE: the first */
    uint32_t first_colour;                   /* BLOB_NONE: white */
    uint32_t first_triangle, triangle_count; /* > 0; behind those of the mesh before */
} blob_mesh_t;

typedef enum { QUADRIC_SPHERE = 1, QUADRIC_DISK = 2, QUADRIC_CYLINDER = 3 } quadric_kind_t;

/* A quadric about the z axis of its own space, with pbrt's (u, v).
 * sphere: radius, the part with z_min <= z <= z_max; disk: at z = z_min, from inner_radius to radius;
 * cylinder: radius, z_min to z_max. All: phi from 0 to phi_max about z from +x towards +y. */
typedef struct {
    uint32_t kind; /* quadric_kind_t */
    xform_t object_from_quadric;
    float radius, inner_radius, z_min, z_max;
    float phi_max; /* radians, at most 2 pi (as the float nearest to it) */
} blob_quadric_t;

typedef struct {
    float x, y, z, radius;
} blob_curve_point_t;

typedef enum {
    CURVES_ROUND = 1,
    CURVES_RIBBON = 2,
    CURVES_FIBRE = 3,     /* hair: a band that faces each ray; its material is MATERIAL_HAIR */
    CURVES_FLAT_FIBRE = 4 /* the same, whose normal does not turn from edge to edge */
} curves_kind_t;

static inline bool curves_are_fibres(uint32_t kind)
{
    return kind == CURVES_FIBRE || kind == CURVES_FLAT_FIBRE;
}

/* Cubic Bezier segments, four points each; u runs from 0 to 1 along all of them, v across. */
typedef struct {
    uint32_t kind;                       /* curves_kind_t */
    uint32_t first_point, segment_count; /* > 0 segments of 4 points each */
    uint32_t first_normal; /* of a ribbon: 4 normals a segment in the normals section; else BLOB_NONE */
} blob_curves_t;

typedef enum { SHAPE_MESH = 1, SHAPE_QUADRIC = 2, SHAPE_CURVES = 3 } shape_kind_t;

/* Geometric normals: of a triangle, (p1 - p0) x (p2 - p0), or, where the mesh has vertex normals, whichever
 * of the two signs agrees with them; of a quadric, away from its axis or centre, of a disk +z. SHAPE_FLIP
 * reverses those that do not come from vertex normals (of a mesh: pbrt's ReverseOrientation exclusive-or a
 * mirroring transform; of a quadric the same, but of one that emits ReverseOrientation alone).
 * SHAPE_CUTOUT: alpha 0 lets rays through, anything else stops them; without it alpha is the probability of
 * stopping a ray.
 * SHAPE_NORMALS_V3: light that a light sends to what the camera sees is also reflected where the shading and
 * the geometric normal disagree about its side or the camera's, as in pbrt-v3.
 * SHAPE_BUMPS_V3, of meshes alone: where there are vertex normals, bump maps stand on unit vectors along
 * -dp/du and -dp/dv.
 * SHAPE_INTERFACE: it parts two media. Behind any other shape the medium is that before it.
 */
enum { SHAPE_FLIP = 1, SHAPE_CUTOUT = 2, SHAPE_BUMPS_V3 = 4, SHAPE_NORMALS_V3 = 8, SHAPE_INTERFACE = 16 };

/* ---- values and textures ------------------------------------------------------------------------------- */

/* A number or a colour that may vary over a surface: `factor`, times the texture's value there if there is
 * one. Numbers are the x of a colour. All zeroes are the constant 0. In spectral jobs a value with a spectrum
 * and no texture is that spectrum, times the largest component of `factor`. Only values of materials, and the
 * radiance of lights without an image, have spectra. */
typedef struct {
    rgb_t factor;
    blob_ref_t texture, spectrum;
} blob_value_t;

/* From BLOB_SPECTRUM_FIRST on by BLOB_SPECTRUM_STEP, linear in between; from 0 to 1e9. */
typedef struct {
    float samples[BLOB_SPECTRUM_SAMPLES];
} blob_spectrum_t;

typedef struct {
    uint32_t kind;     /* shape_kind_t */
    uint32_t geometry; /* index of a mesh, quadric or set of curves */
    uint32_t material; /* index of a material */
    uint32_t light;    /* index of the area light that this shape emits, or BLOB_NONE */
    uint32_t flags;
    uint32_t name;             /* offset in the strings: where the shape comes from, "file:line" */
    blob_value_t alpha;        /* opacity; factor 1 without texture: opaque. Not of curves */
    blob_value_t shadow_alpha; /* the same, for shadow rays alone and on top of alpha */
    blob_ref_t media[2];       /* of SHAPE_INTERFACE: on the side away from the normal, on that of the normal;
                                  0: empty space */
} blob_shape_t;

typedef struct {
    uint32_t first_shape, shape_count;
} blob_object_t;

typedef struct {
    uint32_t object; /* not 0; shapes in it do not emit */
    xform_t world_from_object;
    xform_t world_from_object_end; /* at time 1; equal to world_from_object when it stands still. In between,
                                      translation, rotation and stretch are interpolated each */
} blob_instance_t;

typedef enum { TEXELS_R8 = 1, TEXELS_RGBA8 = 2, TEXELS_R32F = 3, TEXELS_RGB32F = 4 } texels_t;

/* Of one pixel, of a known format. */
static inline uint32_t blob_texel_bytes(uint32_t format)
{
    return format == TEXELS_R8 ? 1 : format == TEXELS_RGB32F ? 12 : 4;
}

/* An image, cut from the top into bands of BLOB_BAND_ROWS rows, the last of as many as are left. A band is
 * its columns from the left, each from the top, so that what is close to each other in the image is close in
 * the file, too. There are no gaps; the whole starts at a word of the texels. See blob_image_row. */
typedef struct {
    uint32_t format; /* texels_t; alpha is never encoded */
    uint32_t width, height;
    uint32_t first_word;
    float gamma; /* of 8-bit formats: 0: sRGB transfer function; else linear = encoded ^ gamma, 1: linear */
} blob_image_t;

/* Where the pixels of a row of an image lie: the pixel in column x is the image's (first + x * step)-th. */
typedef struct {
    size_t first, step;
} blob_row_t;
static inline blob_row_t blob_image_row(uint32_t width, uint32_t height, uint32_t y)
{
    uint32_t within = y % BLOB_BAND_ROWS, top = y - within, rows = height - top;
    return (blob_row_t){(size_t)top * width + within, rows < BLOB_BAND_ROWS ? rows : BLOB_BAND_ROWS};
}

typedef enum { WRAP_REPEAT = 1, WRAP_CLAMP = 2, WRAP_BLACK = 3, WRAP_MIRROR = 4 } wrap_t;

typedef enum {
    CHANNEL_RGB = 1,
    CHANNEL_R,
    CHANNEL_G,
    CHANNEL_B,
    CHANNEL_A,         /* 1 where the image has none */
    CHANNEL_LUMINANCE, /* 0.212671 R + 0.715160 G + 0.072169 B */
    CHANNEL_MEAN       /* (R + G + B) / 3 */
} channel_t;

typedef enum {
    MAPPING_UV = 1,          /* (s, t) = matrix (u, v, 1) */
    MAPPING_UV2 = 2,         /* the same with the mesh's second uvs */
    MAPPING_PLANAR = 3,      /* (s, t) = x and y of texture_from_world p */
    MAPPING_SPHERICAL = 4,   /* q = texture_from_world p: (theta / pi, phi / 2 pi) */
    MAPPING_CYLINDRICAL = 5, /* ((pi + atan2(q.y, q.x)) / 2 pi, q.z) of q / |q| */
    MAPPING_POINT = 6,       /* three coordinates, texture_from_world p: of the textures of space */
    MAPPING_CYLINDER = 7     /* as CYLINDRICAL, of q itself */
} mapping_t;

/* What a texture computes. In brackets its inputs, then its parameters, in order; "2D" are those that look at
 * (s, t), "3D" those that take MAPPING_POINT. Noise is Perlin's ("Improving Noise", 2002). */
typedef enum {
    TEXTURE_IMAGE = 1,     /* [scale]: scale times the image; 2D */
    TEXTURE_SCALE,         /* [a, b]: a b */
    TEXTURE_MIX,           /* [a, b, amount]: (1 - amount) a + amount b */
    TEXTURE_DIRECTION_MIX, /* [a, b], x y z of a direction d: as mix, with amount |n . d| of b */
    TEXTURE_BILERP,        /* [v00, v01, v10, v11]: v10 at s = 1, t = 0; 2D */
    TEXTURE_UV,            /* (s - floor s, t - floor t, 0); 2D */
    TEXTURE_CHECKERBOARD,  /* [a, b]: a where the sum of the coordinates' floors is even; 2D or 3D */
    TEXTURE_DOTS,          /* [inside, outside]: pbrt's random dots; 2D */
    TEXTURE_FBM,           /* octaves, roughness: fractional Brownian motion; 3D */
    TEXTURE_WRINKLED,      /* octaves, roughness: turbulence; 3D */
    TEXTURE_WINDY,         /* pbrt's waves; 3D */
    TEXTURE_MARBLE,        /* octaves, roughness, scale, variation; 3D */
    TEXTURE_CHANNEL,       /* [a]: `channel` of it as a grey */
    TEXTURE_THRESHOLD,     /* [a], cutoff: 1 where a.x >= cutoff, else 0 */
    TEXTURE_COLOUR,        /* the mesh's colours, interpolated; channel RGB or A */
    TEXTURE_KIND_END
} texture_kind_t;

enum { TEXTURE_INPUTS = 4, TEXTURE_PARAMETERS = 4 };
enum {
    TEXTURE_NEAREST = 1, /* no interpolation between texels */
    TEXTURE_INVERT = 2,  /* of an image: 1 - value, at least 0, after the scale */
    TEXTURE_UNIT = 4     /* of an image: at most 1, after all that */
};

typedef struct {
    uint32_t kind;    /* texture_kind_t */
    uint32_t mapping; /* mapping_t; 0 where the kind needs none */
    float matrix[2][3];
    xform_t texture_from_world;
    blob_ref_t image;
    uint32_t channel;        /* channel_t */
    uint32_t wrap_s, wrap_t; /* wrap_t */
    uint32_t flags;
    blob_value_t inputs[TEXTURE_INPUTS];
    float parameters[TEXTURE_PARAMETERS];
} blob_texture_t;

/* ---- materials ----------------------------------------------------------------------------------------- */

/* The places of a material's values. Colours are factors on what physics gives. */
typedef enum {
    VALUE_REFLECTANCE,   /* of the diffuse part, the base, or the metal (a factor); pbrt-v3's Kd */
    VALUE_TRANSMITTANCE, /* Kt; glTF's colour of diffuse transmission */
    VALUE_SPECULAR,      /* of the glossy part; Ks */
    VALUE_MIRROR,        /* of the mirror part; Kr */
    VALUE_REFLECT,       /* pbrt-v3's translucent */
    VALUE_TRANSMIT,
    VALUE_OPACITY,
    VALUE_AMOUNT, /* of the second part of a mix */
    VALUE_SIGMA,  /* degrees; of Oren-Nayar */
    VALUE_ROUGHNESS_U,
    VALUE_ROUGHNESS_V,
    VALUE_ETA,              /* index of refraction, relative to the outside */
    VALUE_K,                /* absorption index of a metal */
    VALUE_BASE_ROUGHNESS_U, /* of what lies below a coat */
    VALUE_BASE_ROUGHNESS_V,
    VALUE_BASE_ETA,
    VALUE_THICKNESS, /* of a coat */
    VALUE_ALBEDO,    /* of the medium in it */
    VALUE_G,
    VALUE_METALLIC,
    VALUE_SPECULAR_TINT,
    VALUE_ANISOTROPIC,
    VALUE_SHEEN,
    VALUE_SHEEN_TINT,
    VALUE_CLEARCOAT,
    VALUE_CLEARCOAT_GLOSS,     /* Disney's; glTF has the roughness */
    VALUE_CLEARCOAT_ROUGHNESS, /* glTF's */
    VALUE_SPECULAR_COLOUR,
    VALUE_TRANSMISSION, /* share of the light that passes: Disney's spectrans, glTF's transmission */
    VALUE_FLATNESS,
    VALUE_DIFFUSE_TRANSMISSION,
    VALUE_ATTENUATION, /* glTF's volume: per unit length, light fades as exp(-a d) */
    VALUE_SHEEN_COLOUR,
    VALUE_SHEEN_ROUGHNESS,
    VALUE_IRIDESCENCE,           /* weight of a thin film ... */
    VALUE_IRIDESCENCE_ETA,       /* ... its index of refraction ... */
    VALUE_IRIDESCENCE_THICKNESS, /* ... and its thickness in nanometres */
    VALUE_DISPERSION,            /* glTF's: 20 / Abbe number */
    VALUE_ANISOTROPY_DIRECTION,  /* glTF's: (x + 1) / 2 and (y + 1) / 2 of it, along the tangents ... */
    VALUE_ANISOTROPY_TURN,       /* ... and cosine and sine of the angle by which it is turned */
    VALUE_EXPONENT,              /* Phong's */
    VALUE_EUMELANIN,             /* concentrations of what makes hair brown ... */
    VALUE_PHEOMELANIN,           /* ... and red */
    VALUE_TILT,                  /* degrees by which the scales of hair stand off */
    MATERIAL_VALUES
} material_value_t;

/* In brackets the values that a kind reads, VALUE_ left out. ROUGHNESS stands for both axes; it becomes the
 * alphas of the Trowbridge-Reitz distribution as the REMAP flags say. An alpha below 1e-3 in both axes makes
 * a specular lobe of a dielectric, conductor, or coat. */
typedef enum {
    MATERIAL_DIFFUSE = 1,          /* [REFLECTANCE, SIGMA]: Lambert, or Oren-Nayar where sigma is not 0 */
    MATERIAL_MIRROR,               /* [REFLECTANCE] */
    MATERIAL_DIELECTRIC,           /* [REFLECTANCE, TRANSMITTANCE, ETA, ROUGHNESS]; THIN: a pane;
                                      TINTED_BODY: [ALBEDO] */
    MATERIAL_CONDUCTOR,            /* [REFLECTANCE, ETA, K, ROUGHNESS] */
    MATERIAL_PLASTIC,              /* pbrt-v3's [REFLECTANCE, SPECULAR, ROUGHNESS] */
    MATERIAL_UBER,                 /* pbrt-v3's [REFLECTANCE, SPECULAR, MIRROR, TRANSMITTANCE, OPACITY, ETA,
                                      ROUGHNESS] */
    MATERIAL_SUBSTRATE,            /* pbrt-v3's [REFLECTANCE, SPECULAR, ROUGHNESS] */
    MATERIAL_TRANSLUCENT,          /* pbrt-v3's [REFLECTANCE, SPECULAR, REFLECT, TRANSMIT, ROUGHNESS] */
    MATERIAL_MIX,                  /* [AMOUNT] of parts[1], the rest of parts[0] */
    MATERIAL_DISNEY,               /* pbrt-v3's [REFLECTANCE, METALLIC, ETA, ROUGHNESS_U, SPECULAR_TINT,
                                      ANISOTROPIC, SHEEN, SHEEN_TINT, CLEARCOAT, CLEARCOAT_GLOSS, TRANSMISSION,
                                      FLATNESS, DIFFUSE_TRANSMISSION]; THIN; TINTED_BODY: [ALBEDO] */
    MATERIAL_COATED_DIFFUSE,       /* pbrt-v4's [REFLECTANCE, ETA, ROUGHNESS, THICKNESS, ALBEDO, G]; TINTED */
    MATERIAL_COATED_CONDUCTOR,     /* pbrt-v4's [ETA, ROUGHNESS, THICKNESS, ALBEDO, G, BASE_ETA, K,
                                      BASE_ROUGHNESS]; TINTED */
    MATERIAL_DIFFUSE_TRANSMISSION, /* [REFLECTANCE, TRANSMITTANCE] */
    MATERIAL_GLTF,                 /* [REFLECTANCE, METALLIC, ROUGHNESS_U, ETA, SPECULAR, SPECULAR_COLOUR,
                                      CLEARCOAT, CLEARCOAT_ROUGHNESS, TRANSMISSION, ATTENUATION,
                                      THICKNESS after which that leaves a given colour, SHEEN_COLOUR,
                                      SHEEN_ROUGHNESS, ANISOTROPIC, ANISOTROPY_DIRECTION, ANISOTROPY_TURN,
                                      DIFFUSE_TRANSMISSION, TRANSMITTANCE, IRIDESCENCE, IRIDESCENCE_ETA,
                                      IRIDESCENCE_THICKNESS, DISPERSION]; THIN without a volume; COAT_NORMAL */
    MATERIAL_FOURIER,              /* table: one of the fouriers */
    MATERIAL_MEASURED,             /* table: one of the measurements */
    MATERIAL_PHONG,                /* Mitsuba's [REFLECTANCE, SPECULAR, EXPONENT] */
    MATERIAL_WARD,                 /* Mitsuba's [REFLECTANCE, SPECULAR, ROUGHNESS]; the model of 1992 ... */
    MATERIAL_WARD_DUER,            /* ... that of 2006 ... */
    MATERIAL_WARD_BALANCED,        /* ... and that of 2010 */
    MATERIAL_INTERFACE,            /* []: nothing but the border of media; light goes straight through. Its
                                      shapes are SHAPE_INTERFACE, do not emit, and are no curves */
    MATERIAL_HAIR, /* pbrt's [ATTENUATION, EUMELANIN, PHEOMELANIN, ETA, TILT, ROUGHNESS_U along
                      the hair, ROUGHNESS_V about it]: what absorbs adds up, per radius of the
                      hair. DYED: [REFLECTANCE] says how much instead */
    MATERIAL_KIND_END
} material_kind_t;

enum {
    MATERIAL_REMAP_V3 = 1,     /* pbrt-v3's fit */
    MATERIAL_REMAP_SQRT = 2,   /* pbrt-v4's: alpha = sqrt(roughness) */
    MATERIAL_REMAP_SQUARE = 4, /* glTF's: alpha = roughness^2 */
    MATERIAL_THIN = 8,
    MATERIAL_UNIT = 32,        /* pbrt-v4's: REFLECTANCE, TRANSMITTANCE, ALBEDO and AMOUNT are at most 1 */
    MATERIAL_COAT_NORMAL = 64, /* the coat has a normal of its own: that of the surface, turned by the
                                  coat_normal_map where there is one */
    MATERIAL_CHOSEN = 1024, /* of a mix: each point has one of the parts, by chance, with the relief of that
                               part; else both, with the relief of the mix */
    MATERIAL_NORMALS_V4 = 2048, /* the y of the normal_map is along n x dp/du, as in pbrt-v4: where uvs are
                                   mirrored, dp/dv lies on the other side */
    MATERIAL_DYED = 256,        /* hair absorbs so that many of them together have the colour REFLECTANCE */
    MATERIAL_TINTED_BODY =
        512,               /* of a dielectric or Disney's with a body: ALBEDO is the colour of what is below
                              the surface over that of the body; the interface lets its root pass, both
                              ways. Disney's has an interface then, in the place of its diffuse part */
    MATERIAL_TINTED = 128, /* SPECULAR is a factor on what the coat of a coated material reflects */
    MATERIAL_ALPHA_V3 = 16 /* alphas as pbrt-v3 bounds them: smooth is only a dielectric whose roughness is 0
                              in both axes; else they are at least 1e-3. REMAP_V3 implies it */
};

typedef struct {
    uint32_t kind; /* material_kind_t */
    uint32_t name; /* offset in the strings */
    uint32_t flags;
    uint32_t parts[2];          /* of a mix: materials before this one */
    uint32_t table;             /* of a material that is one; else 0 */
    blob_ref_t body;            /* 0, or the medium below the surface: subsurface scattering. Its shapes are
                                   SHAPE_INTERFACE and have it inside. Paths through it may be longer than
                                   through other media (docs/renderer.md) */
    blob_ref_t normal_map;      /* texture whose value 2 v - 1 is the normal along (dp/du, dp/dv, n) */
    float normal_scale;         /* of its x and y */
    blob_ref_t bump;            /* texture of a displacement along the normal, which turns the normal alone */
    blob_ref_t coat_normal_map; /* as normal_map, of the coat; 0 without MATERIAL_COAT_NORMAL */
    float coat_normal_scale;
    blob_value_t values[MATERIAL_VALUES];
} blob_material_t;

/* ---- media --------------------------------------------------------------------------------------------- */

typedef enum {
    FIELD_CELLS = 1, /* a number, or a colour, for each cell, x varying fastest */
    FIELD_BRICKS,    /* numbers of some bricks of BLOB_BRICK_SIDE cells a side, z varying fastest there */
    FIELD_CLOUD      /* pbrt-v4's cloud: parameters: density, wispiness, frequency */
} field_kind_t;

/* A number, or a colour, that varies over a box, the unit cube of the field's own space: at u lies the place
 * origin + u span. The number of cell (i, j, k) stands at that place; in between numbers are interpolated,
 * and where there are no cells they are 0. Outside of the box there is nothing. Of a cloud the place is the
 * point that its formula takes. */
typedef struct {
    uint32_t kind;     /* field_kind_t */
    uint32_t channels; /* 1; of FIELD_CELLS also 3 */
    uint32_t cells[3]; /* of bricks: multiples of BLOB_BRICK_SIDE; of a cloud 0 */
    uint32_t first;    /* in the numbers: not negative */
    uint32_t
        first_brick;      /* in the bricks: for each brick of the grid, x varying fastest, which of the
                             field's own it is, or BLOB_NONE: 0 everywhere. Bricks that are alike may be one */
    uint32_t brick_count; /* own bricks: so many times BLOB_BRICK_CELLS numbers */
    float origin[3], span[3];
    float parameters[3];
    xform_t world_from_field;
} blob_field_t;

/* What fills space and scatters, absorbs or emits light: evenly, or as fields say. */
typedef struct {
    uint32_t name;                /* offset in the strings */
    rgb_t absorption, scattering; /* per unit length in the world, times the density and their tints */
    rgb_t emission;     /* radiance per unit length likewise, of what absorbs or of itself: times the
                           density, the tint of the absorption, that of the emission, and glow */
    float g;            /* of Henyey and Greenstein's phase function: from -1 to 1, backwards to
                           forwards, both excluded */
    blob_ref_t density; /* one of the fields, of numbers; 0: 1 everywhere */
    blob_ref_t absorption_tint, scattering_tint; /* fields of colours over the same box and cells, of a medium
                                                    without density; outside of the box there is nothing */
    blob_ref_t emission_tint;                    /* where there is a field of one of the others */
    blob_ref_t temperature; /* of numbers, likewise. Glow is 0 where it is at most `coldest`, and up to
                               `hottest` between BLOB_GLOW_STEPS colours, which lie evenly */
    float coldest, hottest;
    uint32_t first_glow;   /* in the numbers: linear sRGB */
    uint32_t is_of_colour; /* 1: an even body whose albedo was made of the colour that it shows, which a
                              spectral job takes for what is given; else 0 */
} blob_medium_t;

/* ---- tables of BSDFs ----------------------------------------------------------------------------------- */

/* A BSDF between `nodes` cosines as Fourier series in the difference of azimuths (Jakob, d'Eon, Jakob and
 * Marschner 2014, "A Comprehensive Framework for Rendering Layered Materials"). What light does is told by
 * mu_i, the cosine of the direction in which it arrives, and mu_o, that of the one in which it leaves:
 * reflection turns the sign, transmission keeps it. Between the nodes lie Catmull-Rom splines in both.
 *
 * For sampling alone there are, for each outgoing node, the probabilities of cells: between two nodes of
 * mu_i, and there between the azimuths pi (k / FOURIER_AZIMUTHS)^2. They are kept as cumulative sums, from 0
 * to 1. */
enum { FOURIER_AZIMUTHS = 32 };
typedef struct {
    uint32_t nodes;             /* from 2 on */
    uint32_t channels;          /* 1: luminance; 3: luminance, red, blue */
    uint32_t first_node;        /* in the numbers: the cosines, ascending */
    uint32_t first_series;      /* that of nodes i and o is the (o nodes + i)th */
    uint32_t first_marginal;    /* in the numbers: `nodes` sums for each outgoing node */
    uint32_t first_conditional; /* FOURIER_AZIMUTHS + 1 sums for each cell between nodes of mu_i, nodes - 1
                                   for each outgoing node */
    float eta;                  /* index of refraction of the inside over the outside */
    rgb_t albedo;               /* about */
} blob_fourier_t;

/* value(phi) = sum over k < count of a_k cos(k phi), times |mu_i|; of channel c a_k is the number first +
 * c count + k. */
typedef struct {
    uint32_t first, count;
} blob_series_t;

/* A table of width x height numbers, rows one behind the other, over the unit square: the first and the last
 * of a row lie at 0 and 1. In between they are interpolated. */
typedef struct {
    uint32_t first; /* in the numbers */
    uint32_t width, height;
} blob_grid_t;

/* A measured BRDF (Dupuy and Jakob 2018, "An Adaptive Parameterization for Efficient Material Acquisition and
 * Rendering"). A direction of elevation theta (from the normal) and azimuth phi is the point
 * (sqrt(2 theta / pi), phi / (2 pi) + 1/2) of the unit square.
 *
 * What depends on the outgoing direction is a slice for each of some azimuths and elevations, the elevation
 * varying faster; in between slices are interpolated. A grid with sums has the densities of all slices, each
 * of which integrates to 1 when the square's sides are width - 1 and height - 1; then for each slice the
 * integral over its rows up to each of them; then for each row the integral up to each column. */
typedef struct {
    uint32_t azimuths, elevations;
    uint32_t first_azimuth, first_elevation; /* in the numbers: radians, ascending */
    uint32_t isotropic;    /* 1: azimuths of normals count from that of the outgoing direction */
    blob_grid_t ndf;       /* the density of microfacet normals */
    blob_grid_t sigma;     /* their projected area, over the outgoing direction */
    blob_grid_t visible;   /* with sums: the visible normals */
    blob_grid_t luminance; /* with sums: over what `visible` makes uniform */
    uint32_t first_colour; /* in the numbers: linear sRGB for each number of luminance's slices */
    rgb_t albedo;          /* about */
} blob_measured_t;

/* ---- lights -------------------------------------------------------------------------------------------- */

typedef enum {
    LIGHT_AREA = 1,    /* radiance of a shape; its texture is looked up at the shape's (u, v) */
    LIGHT_POINT,       /* intensity, at the light's origin */
    LIGHT_SPOT,        /* intensity about the light's +z; parameters: cosines of the outer and inner angles */
    LIGHT_GONIOMETRIC, /* intensity times the image */
    LIGHT_PROJECTION,  /* intensity times the image, which fills the window x min, x max, y min, y max
                          (parameters) on the plane z = 1, y up; black elsewhere */
    LIGHT_DISTANT,     /* irradiance on a surface that faces it; it stands at the light's +z */
    LIGHT_INFINITE     /* radiance, times the image where there is one */
} light_kind_t;

/* How an image is laid over the directions of its light; d is a unit direction in light space. */
typedef enum {
    LIGHT_LATLONG = 1, /* rows from d = +z to -z, columns from +x towards +y: pbrt-v3's infinite light */
    LIGHT_LATLONG_Y,   /* rows from +y to -y, columns from +x towards +z: pbrt-v3's goniometric light, and
                          environments that pbrt does not have: of an infinite light rows end at the poles */
    LIGHT_OCTAHEDRAL   /* equal areas (Clarberg 2008), as pbrt-v4's */
} light_mapping_t;

enum {
    LIGHT_TWO_SIDED = 1,
    LIGHT_SMOOTHSTEP = 2, /* a spot's rim is a smooth step of the cosine (pbrt-v4) ... */
    LIGHT_SQUARE = 4,     /* ... the square of its fraction (glTF); else its fourth power (pbrt-v3) */
    LIGHT_UNSEEN = 8,     /* an area light that no ray runs into; its shape's alpha is the number 0 */
    LIGHT_COSINE = 16,    /* all of a spot is also dimmed by the cosine (Cycles of Blender before 3.5) */
    LIGHT_PICTURE = 32, /* an area light that lights nothing: only rays of the camera meet its shape, straight
                        or by mirrors and clear glass; all others go through. Its shape is a mesh, whose
                        material scatters nothing */
    LIGHT_PORTAL = 64,  /* all of an infinite light comes through a rectangle: see `portal` */
    LIGHT_SMOOTH = 128  /* an octahedral image is looked up bilinearly, not at the nearest texel */
};

typedef struct {
    uint32_t kind; /* light_kind_t */
    uint32_t flags;
    blob_value_t radiance; /* or what the kind says; only an area light's may have a texture */
    uint32_t shape;        /* of an area light: the one shape of the world that it is; else 0 */
    blob_ref_t image;
    blob_ref_t medium; /* that it shines into; of an area light whose shape is an interface, and of lights at
                          infinity, 0 */
    uint32_t mapping;  /* light_mapping_t of the image */
    xform_t world_from_light;
    float parameters[4];
    vec3_t portal[3]; /* of LIGHT_PORTAL, in the world: a corner of the rectangle and its sides a and b from
                         there, at right angles. A segment to the sky shows the light where it crosses the
                         rectangle towards a x b, the side on which the sky is; else nothing */
} blob_light_t;

#endif
