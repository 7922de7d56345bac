/* params: the parameter list of a directive: "type name" followed by a value or [ values ].
 *
 * A list remembers which of its parameters somebody read. What is left unread at the end is reported
 * (params_finish), so that nothing a user wrote is passed over in silence. Getters take the value's default
 * in the out argument and leave it alone when the parameter is not there; a parameter with the wrong number
 * of values is an error at its place, or, to pbrt-v3, not there.
 *
 * As in either pbrt a parameter is looked up by its name and its type together, so that one of the wrong type
 * is not there, and stays unread. Of two with the same name and type the last counts. In pbrt-v3 all that
 * says a colour is one type, and a texture goes before a colour or a number of the same name.
 *
 * A list may have a fallback, which is searched second: the defaults of an `Attribute` (pbrt-v4), or the
 * parameters of the material that a shape's own override (pbrt-v3).
 */
#ifndef LIGHTMILL_PARAMS_H
#define LIGHTMILL_PARAMS_H

#include "client/import/pbrt/syntax/dialect.h"

typedef enum {
    PARAM_INTEGER,
    PARAM_FLOAT,
    PARAM_POINT2,
    PARAM_VECTOR2,
    PARAM_POINT3,
    PARAM_VECTOR3,
    PARAM_NORMAL3,
    PARAM_RGB,
    PARAM_XYZ,
    PARAM_BLACKBODY,
    PARAM_SPECTRUM,
    PARAM_BOOL,
    PARAM_STRING,
    PARAM_TEXTURE
} param_type_t;

#define PARAM_BIT(type) (1u << (type))
/* What says a colour, without textures. */
enum {
    PARAM_COLOURS =
        PARAM_BIT(PARAM_RGB) | PARAM_BIT(PARAM_XYZ) | PARAM_BIT(PARAM_BLACKBODY) | PARAM_BIT(PARAM_SPECTRUM)
};

/* One parameter. `count` is of numbers (bools are numbers 0 and 1) or, where the values are quoted, of
 * strings. */
typedef struct {
    param_type_t type;
    bool quoted;
    bool used;
    bool miscounted; /* somebody looked for one value; of an unused parameter */
    unsigned wanted; /* the types that somebody looked for under this name; of an unused parameter */
    position_t at;
    size_t name;  /* offset in the list's text */
    size_t first; /* index among the list's numbers, or strings */
    size_t count;
} param_t;

typedef struct params params_t;

params_t *params_new(void);
/* Frees the list and sets *params to NULL. */
void params_destroy(params_t **params);
/* Empties the list for another directive; the fallback is forgotten. */
void params_clear(params_t *params);
/* `fallback` (may be NULL, may have a fallback itself) is kept by the caller while the list is used. */
void params_set_fallback(params_t *params, params_t *fallback);

/* Reads the parameters that come next in the file, adding to the list, by the rules of a dialect. A parameter
 * that is given twice is tolerated. */
result_t params_parse(params_t *params, lexer_t *lexer, dialect_t dialect, report_t *report);

/* The parameter of one of `types` (PARAM_BITs), marked as used, or NULL. *owner is the list whose values it
 * indexes. */
const param_t *params_find(params_t *params, const char *name, unsigned types, const params_t **owner);
/* Whether there is one of any type. Does not mark it as used. */
bool params_has(const params_t *params, const char *name);
const double *params_numbers(const params_t *owner, const param_t *param);
const char *params_text(const params_t *owner, const param_t *param, size_t index);
const char *param_type_name(param_type_t type);

result_t params_float(params_t *params, const char *name, double *value);
/* Also checks that low <= value <= high. */
result_t params_float_in(params_t *params, const char *name, double low, double high, double *value);
result_t params_int_in(params_t *params, const char *name, int low, int high, int32_t *value);
result_t params_bool(params_t *params, const char *name, bool *value);
/* *value is valid as long as the list is not changed. */
result_t params_string(params_t *params, const char *name, const char **value);
/* All numbers of a parameter of one of `types` (PARAM_BITs), whose count must be a multiple of `group`; NULL
 * and 0 when it is not there. */
result_t params_array(params_t *params, const char *name, unsigned types, size_t group, const double **values,
                      size_t *count);
/* Three numbers: one point or vector of one of `types`. */
result_t params_point(params_t *params, const char *name, unsigned types, double point[3]);
/* Whether `known` says so of the name of every texture in the list. */
bool params_textures_known(const params_t *params, bool (*known)(const void *context, const char *texture),
                           const void *context);
/* Where the parameter stands, or `otherwise`. Does not mark it as used. */
position_t params_where(const params_t *params, const char *name, position_t otherwise);

/* What to do about a parameter that Lightmill does not use. */
typedef enum {
    PARAM_ACCEPT, /* without a word: it means nothing to any renderer's picture (an output's name) */
    PARAM_IGNORE, /* warn: it hardly changes the picture */
    PARAM_REFUSE  /* fail (a lenient import warns): without it the picture is another */
} param_fate_t;

/* Of one parameter, or of some that share the reason. */
typedef struct {
    const char *names[6]; /* as many as are not NULL */
    param_fate_t fate;
    const char *why; /* completes `"name": ...` */
} param_rule_t;

/* Applies the rules to those parameters that are there and unread. */
result_t params_apply(params_t *params, const param_rule_t *rules, size_t count, report_t *report);
/* Reports what nobody has read: `strict` (pbrt-v4, which does the same) refuses, otherwise (pbrt-v3, which
 * ignores what it does not know) warns. `what` names the directive. Fallbacks are not looked at. */
result_t params_finish(params_t *params, const char *what, bool strict, report_t *report);
/* Parameters of the list itself that nobody has read so far. */
size_t params_unread(const params_t *params);

#endif
