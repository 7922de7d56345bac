/* state: everything that is known while a pbrt scene is read: the graphics state and its stack, names and
 * materials. The scene that comes of them is the builder's.
 *
 * Materials are made when a shape first uses them: what nothing uses may well be unsupported.
 */
#ifndef LIGHTMILL_STATE_H
#define LIGHTMILL_STATE_H

#include "client/import/files/intern.h"
#include "client/import/pbrt/syntax/dialect.h"
#include "client/import/pbrt/syntax/names.h"
#include "client/import/pbrt/syntax/params.h"
#include "client/import/scene/scene_images.h"

enum { MAX_SCOPES = 1000, MAX_INCLUDES = 32, ARGUMENTS = 3 };

/* The directives that `Attribute` (v4) sets default parameters for. */
typedef enum {
    TARGET_SHAPE,
    TARGET_LIGHT,
    TARGET_MATERIAL,
    TARGET_MEDIUM,
    TARGET_TEXTURE,
    TARGET_COUNT,
    TARGET_NONE = TARGET_COUNT /* what takes no defaults */
} target_t;

/* Which of the two transforms the transform directives change: ActiveTransform. */
enum { ACTIVE_START = 1, ACTIVE_END = 2 };

/* An AreaLightSource. */
typedef struct {
    blob_light_t light; /* its radiance and flags; with a power: the colour, whatever its scale */
    double power; /* that a shape emits (v4), of a light of mean luminance 1; 0: the radiance is given */
    double mean;  /* luminance of its image; 1 without */
    position_t at;
} area_light_t;

/* What AttributeBegin saves and AttributeEnd restores. */
typedef struct {
    affine_t ctm, ctm_end; /* at the two times of TransformTimes */
    unsigned active;       /* ACTIVE_START, ACTIVE_END or both */
    bool reverse;          /* ReverseOrientation */
    uint32_t material;     /* index in materials */
    bool emits;            /* an AreaLightSource is in force */
    uint32_t media[2];     /* of the MediumInterface, inside and outside: 1 + index in media, 0: empty */
    area_light_t light;
    size_t colour_space;              /* of rgb values (v4): see pbrt_srgb */
    params_t *defaults[TARGET_COUNT]; /* owned by the state's kept lists; NULL: none */
} graphics_t;

typedef enum { SCOPE_ATTRIBUTE, SCOPE_TRANSFORM, SCOPE_OBJECT, SCOPE_IMPORT } scope_kind_t;

typedef struct {
    scope_kind_t kind;
    position_t at; /* of the Begin */
    graphics_t saved;
    size_t textures[2], materials; /* names known outside; v3 forgets those made inside */
} scope_t;

/* A Material or MakeNamedMaterial directive. Owned: params, name. */
typedef struct {
    size_t entry;     /* in the table of materials */
    params_t *params; /* NULL: only named so far (v4), at `at` */
    position_t at;
    size_t colour_space; /* of its rgb values */
    char *name;
    bool made, making;
    uint32_t index;     /* in the blob, once made; BLOB_NONE: an interface */
    blob_ref_t black;   /* of an interface: the surface that emits in its place, 0: not made */
    uint32_t parts[2];  /* of a mix: 1 + index in materials, 0 when it was not known yet */
    size_t textures[2]; /* texture names known then: later ones of the same name do not count */
} material_t;

/* What goes by the name of a medium. Owned: name. */
typedef struct {
    char *name;
    char type[41]; /* as it was made */
    bool made;
    bool awaited;      /* something has it that came before it (v4) */
    bool told;         /* it has been said that it is none */
    blob_ref_t record; /* 0: not made, or of a type that is not supported (v4) */
    position_t at;     /* where it was made, or else first named */
} medium_t;

/* What a Texture directive gives: a constant, or a texture of the blob. */
typedef struct {
    blob_value_t value; /* of a float texture: the number three times */
} texture_t;

/* A file that has been opened. Owned: path, label, data. */
typedef struct {
    char *path;  /* as opened, for messages */
    char *label; /* as the scene calls it, for names in the blob, which must not depend on the machine */
    uint8_t *data;
    size_t size;
    lexer_t outer; /* where to go on in the file that includes this one; see lexer_t */
} source_t;

/* What stands before WorldBegin. A directive only stores it: pbrt makes the last of each kind, at WorldBegin.
 * Owned: type, params. */
typedef enum {
    SETTING_FILM, /* before the camera, some of which depend on it */
    SETTING_CAMERA,
    SETTING_SAMPLER,
    SETTING_INTEGRATOR,
    SETTING_FILTER,
    SETTING_ACCELERATOR,
    SETTING_COUNT
} setting_kind_t;

typedef struct {
    char *type; /* NULL: not there */
    params_t *params;
    position_t at;
} setting_t;

typedef enum { PHASE_OPTIONS = 1, PHASE_WORLD = 2, PHASE_DONE = 4 } phase_t;

typedef struct pbrt {
    report_t *report;
    scene_builder_t *builder;
    dialect_choice_t dialect;
    phase_t phase;

    lexer_t lexer;                   /* of the file that is being read */
    source_t *source;                /* the innermost of: */
    source_t *sources[MAX_INCLUDES]; /* the files that are open, outermost first */
    int open_sources;
    source_t **files; /* all of them; positions point to their paths */
    size_t file_count, file_capacity;
    intern_t seen;       /* the different files that have been opened: see files.c */
    uint64_t seen_bytes; /* of all of them */
    char *folder;        /* of the main file, with a '/' at its end, or empty */

    char *arguments[ARGUMENTS]; /* the strings of the current directive */
    params_t *params;           /* and its parameters */
    params_t **kept;            /* lists of Attribute directives */
    size_t kept_count, kept_capacity;

    graphics_t now;
    scope_t *scopes;
    size_t scope_count, scope_capacity;
    names_t coordinates;    /* values: indices in systems */
    affine_t (*systems)[2]; /* at the two times */
    size_t system_count, system_capacity;

    names_t material_names, object_names, object_lines; /* of objects: indices, and lines in the file */
    names_t texture_names[2];        /* of spectrum and of float textures, which are two name spaces */
    names_t bsdf_files;              /* by their paths: indices of tables in the blob */
    const material_t *in_the_making; /* the material that is being made, or NULL */
    material_t *materials;
    size_t material_count, material_capacity;
    names_t medium_names; /* indices in media */
    medium_t *media;
    size_t medium_count, medium_capacity;
    uint32_t camera_medium; /* as graphics_t.media */
    bool has_body;          /* the material in the making has something below its surface, */
    blob_medium_t body;     /* which is this */
    bool knows_media;       /* pbrt's integrator of that name shows media */
    blob_ref_t interface;   /* the material of shapes that only part media, 0: not made */
    texture_t *textures;
    size_t texture_count, texture_capacity;
    uint32_t object; /* the one that shapes go to; 0: the world */

    blob_scene_t scene;
    double frame_aspect;             /* of the camera; 0: the film's */
    affine_t camera[2];              /* world from camera, at the two times */
    double transform_times[2];       /* of ctm and ctm_end */
    double shutter[2];               /* times 0 and 1 of the blob */
    bool flat_curves;                /* it has been said that flat curves become round */
    bool early_motion;               /* it has been said that motion ends inside the shutter's time */
    int32_t crop[4];                 /* x first, x end, y first, y end in pixels of the film */
    double gain;                     /* of the film, on all light */
    double film_diagonal;            /* mm; only the realistic camera asks */
    rgb_t balance;                   /* the same by channel: v4's whitebalance */
    uint64_t bytes_done, bytes_told; /* of the files, for progress */
    setting_t settings[SETTING_COUNT];
    position_t film_at, camera_at, integrator_at; /* once made; line 0: not there */
} pbrt_t;

void pbrt_begin(pbrt_t *p, scene_builder_t *builder);
/* Frees all that the state owns. */
void pbrt_end(pbrt_t *p);

/* Sets what a scene of the dialect has when it says nothing. */
void pbrt_set_defaults(pbrt_t *p, dialect_choice_t dialect);

/* About a slip that pbrt-v3 goes on after and that ends pbrt-v4: tolerated in v3, an error in v4. `does` says
 * what pbrt-v3 does about it. */
result_t pbrt_slip(pbrt_t *p, position_t at, const char *does, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* Saves the graphics state. Fails beyond MAX_SCOPES. */
result_t pbrt_push(pbrt_t *p, scope_kind_t kind, position_t at);
/* Restores it; fails when the innermost scope is of another kind, unless pbrt goes on. `directive` is the End
 * directive's name. */
result_t pbrt_pop(pbrt_t *p, scope_kind_t kind, const char *directive, position_t at);

/* Gives a transform a name for CoordSysTransform. */
void pbrt_name_coordinates(pbrt_t *p, const char *name, const affine_t *start, const affine_t *end);

/* The current transform when the shutter opens and when it closes; true when they differ. */
bool pbrt_motion(pbrt_t *p, position_t at, affine_t *open, affine_t *close);

/* "label:line" in the blob's strings. */
uint32_t pbrt_name_of_place(pbrt_t *p, position_t at);
/* Where a file that the scene names lies: as pbrt does, from the main file's folder; when it is not there,
 * from that of the file which names it. The caller frees it. */
char *pbrt_resolve(const pbrt_t *p, const char *filename);

/* Whether there is no such file. */
bool pbrt_is_missing(const char *path);
/* About a file that is missing: tolerated in v3, refused in v4. `does` says what pbrt-v3, or a lenient
 * import, does without it. */
result_t pbrt_missing(pbrt_t *p, position_t at, const char *path, const char *does);

#endif
