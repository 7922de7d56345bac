/* dialect: see dialect.h. */
#include "client/import/pbrt/syntax/dialect.h"

#include <stdio.h>
#include <string.h>

/* Names that only one dialect has. `type` is the quoted word after the directive; NULL: the directive alone
 * decides. Names that both have are no evidence and not listed. */
static const struct {
    const char *directive, *type;
    dialect_t dialect;
} evidence[] = {
    {"WorldEnd", NULL, DIALECT_V3},
    {"Attribute", NULL, DIALECT_V4},
    {"Option", NULL, DIALECT_V4},
    {"ColorSpace", NULL, DIALECT_V4},
    {"Import", NULL, DIALECT_V4},
    {"Film", "image", DIALECT_V3},
    {"Film", "rgb", DIALECT_V4},
    {"Film", "gbuffer", DIALECT_V4},
    {"Film", "spectral", DIALECT_V4},
    {"Camera", "environment", DIALECT_V3},
    {"Camera", "spherical", DIALECT_V4},
    {"Sampler", "random", DIALECT_V3},
    {"Sampler", "02sequence", DIALECT_V3},
    {"Sampler", "lowdiscrepancy", DIALECT_V3},
    {"Sampler", "maxmindist", DIALECT_V3},
    {"Sampler", "adaptive", DIALECT_V3},
    {"Sampler", "bestcandidate", DIALECT_V3},
    {"Sampler", "independent", DIALECT_V4},
    {"Sampler", "paddedsobol", DIALECT_V4},
    {"Sampler", "zsobol", DIALECT_V4},
    {"Sampler", "pmj02bn", DIALECT_V4},
    {"Integrator", "directlighting", DIALECT_V3},
    {"Integrator", "whitted", DIALECT_V3},
    {"Integrator", "simplepath", DIALECT_V4},
    {"Integrator", "simplevolpath", DIALECT_V4},
    {"Integrator", "lightpath", DIALECT_V4},
    {"Integrator", "randomwalk", DIALECT_V4},
    {"Material", "matte", DIALECT_V3},
    {"Material", "mirror", DIALECT_V3},
    {"Material", "glass", DIALECT_V3},
    {"Material", "metal", DIALECT_V3},
    {"Material", "plastic", DIALECT_V3},
    {"Material", "substrate", DIALECT_V3},
    {"Material", "translucent", DIALECT_V3},
    {"Material", "uber", DIALECT_V3},
    {"Material", "disney", DIALECT_V3},
    {"Material", "fourier", DIALECT_V3},
    {"Material", "kdsubsurface", DIALECT_V3},
    {"Material", "diffuse", DIALECT_V4},
    {"Material", "conductor", DIALECT_V4},
    {"Material", "dielectric", DIALECT_V4},
    {"Material", "thindielectric", DIALECT_V4},
    {"Material", "coateddiffuse", DIALECT_V4},
    {"Material", "coatedconductor", DIALECT_V4},
    {"Material", "diffusetransmission", DIALECT_V4},
    {"Material", "measured", DIALECT_V4},
    {"Material", "interface", DIALECT_V4},
};

static result_t decide(dialect_choice_t *choice, dialect_t dialect, const token_t *token)
{
    choice->dialect = dialect;
    choice->at = token->at;
    token_quote(token, choice->evidence);
    return result_ok();
}

/* The dialect that alone has this directive, or with a type: this type of the directive; 0 when both have it.
 */
static dialect_t dialect_of(const token_t *directive, const token_t *type)
{
    for (size_t i = 0; i < ARRAY_LENGTH(evidence); ++i) {
        bool typed = evidence[i].type != NULL;
        if (typed == (type != NULL) && token_is(directive, evidence[i].directive) &&
            (!typed || token_is(type, evidence[i].type)))
            return evidence[i].dialect;
    }
    return 0;
}

/* The loop over the tokens: `directive` is the last word that may be one, `declared` says that the string
 * before was the declaration "string type" of a MakeNamedMaterial. */
static result_t search(lexer_t *lexer, dialect_choice_t *choice)
{
    token_t directive = {.text = ""}, token;
    const token_t material = {.kind = TOKEN_WORD, .text = "Material", .length = 8};
    bool declared = false;
    size_t strings = 0;
    for (;;) {
        double number;
        if (lexer_number(lexer, &number)) continue;
        TRY(lexer_next(lexer, &token));
        dialect_t found = 0;
        if (token.kind == TOKEN_END) return result_ok();
        if (token.kind == TOKEN_WORD) {
            if (token_is(&token, "true") || token_is(&token, "false"))
                return decide(choice, DIALECT_V4, &token);
            directive = token;
            strings = 0;
            declared = false;
            found = dialect_of(&directive, NULL);
        } else if (token.kind == TOKEN_STRING) {
            if (strings++ == 0)
                found = dialect_of(&directive, &token);
            else if (declared)
                found = dialect_of(&material, &token);
            declared = token_is(&directive, "MakeNamedMaterial") && token_is(&token, "string type");
        }
        if (found) return decide(choice, found, &token);
    }
}

dialect_choice_t dialect_detect(const char *path, const char *data, size_t size)
{
    dialect_choice_t choice = {.dialect = DIALECT_V4, .at = {path, 0, 0}};
    lexer_t lexer = lexer_begin(path, data, size);
    (void)search(&lexer, &choice); /* malformed input ends the search */
    return choice;
}

static const char *dialect_name(dialect_t dialect)
{
    return dialect == DIALECT_V3 ? "pbrt-v3" : dialect == DIALECT_V4 ? "pbrt-v4" : "pbrt";
}

static result_t wrong_dialect(const dialect_entry_t *entry, const char *kind, const dialect_choice_t *choice,
                              position_t at)
{
    if (choice->at.line == 0)
        return error_at(
            at, "%s \"%s\" is %s's, but this scene was taken for %s since nothing in it says otherwise", kind,
            entry->name, dialect_name(entry->dialects), dialect_name(choice->dialect));
    return error_at(at,
                    "%s \"%s\" is %s's, but this scene is %s because of %s in line %u; do not mix the two",
                    kind, entry->name, dialect_name(entry->dialects), dialect_name(choice->dialect),
                    choice->evidence, choice->at.line);
}

bool entry_knows(const void *table, size_t count, size_t size, const char *name)
{
    for (size_t i = 0; i < count; ++i) {
        const dialect_entry_t *entry = (const dialect_entry_t *)((const char *)table + i * size);
        if (strcmp(entry->name, name) == 0) return true;
    }
    return false;
}

result_t entry_find(const void *table, size_t count, size_t size, const char *kind, const char *name,
                    const dialect_choice_t *choice, position_t at, size_t *index)
{
    const dialect_entry_t *other = NULL;
    for (size_t i = 0; i < count; ++i) {
        const dialect_entry_t *entry = (const dialect_entry_t *)((const char *)table + i * size);
        if (strcmp(entry->name, name) != 0) continue;
        if (entry->dialects & choice->dialect) {
            *index = i;
            return result_ok();
        }
        other = entry;
    }
    if (other) return wrong_dialect(other, kind, choice, at);
    return error_at(at, "unknown %s \"%.40s\"", kind, name);
}
