/* arguments: what every directive does to read what follows its name (see arguments.h). */
#include <stdio.h>
#include <stdlib.h>

#include "client/import/pbrt/state/arguments.h"

result_t pbrt_read_string(pbrt_t *p, int slot, const char *what)
{
    token_t token;
    char quote[TOKEN_QUOTE_SIZE];
    TRY(lexer_next(&p->lexer, &token));
    if (token.kind != TOKEN_STRING)
        return error_at(token.at, "expected %s in quotes, found %s", what, token_quote(&token, quote));
    free(p->arguments[slot]);
    p->arguments[slot] = mem_alloc(token.length + 1);
    return token_unescape(&token, p->arguments[slot]);
}

result_t pbrt_read_numbers(pbrt_t *p, int count, double *numbers, const char *directive, position_t at)
{
    token_t token;
    char quote[TOKEN_QUOTE_SIZE];
    TRY(lexer_peek(&p->lexer, &token));
    bool bracket = token.kind == TOKEN_OPEN;
    if (bracket) TRY(lexer_next(&p->lexer, &token));
    for (int i = 0; i < count; ++i) {
        if (lexer_number(&p->lexer, &numbers[i])) continue;
        TRY(lexer_next(&p->lexer, &token));
        return error_at(token.at, "%s takes %d numbers: expected number %d, found %s", directive, count,
                        i + 1, token_quote(&token, quote));
    }
    if (!bracket) return result_ok();
    TRY(lexer_next(&p->lexer, &token));
    if (token.kind != TOKEN_CLOSE)
        return error_at(token.at, "%s in line %u takes %d numbers: expected ']', found %s", directive,
                        at.line, count, token_quote(&token, quote));
    return result_ok();
}

result_t pbrt_read_params(pbrt_t *p)
{
    params_clear(p->params);
    return params_parse(p->params, &p->lexer, p->dialect.dialect, p->report);
}

result_t pbrt_read_params_for(pbrt_t *p, target_t target)
{
    TRY(pbrt_read_params(p));
    if (target != TARGET_NONE) params_set_fallback(p->params, p->now.defaults[target]);
    return result_ok();
}

result_t pbrt_read_kind(pbrt_t *p, target_t target, const void *table, size_t count, size_t size,
                        const char *what, const char *kind, position_t at, size_t *index)
{
    TRY(pbrt_read_string(p, 0, what));
    TRY(pbrt_read_params_for(p, target));
    *index = LEFT_OUT;
    if (!entry_knows(table, count, size, p->arguments[0]))
        return p->dialect.dialect == DIALECT_V3
                   ? pbrt_slip(p, at, "it is left out", "unknown %s \"%.40s\"", kind, p->arguments[0])
                   : report_refuse(p->report, at, "unknown %s \"%.40s\"; it is left out", kind,
                                   p->arguments[0]);
    return entry_find(table, count, size, kind, p->arguments[0], &p->dialect, at, index);
}

result_t pbrt_finish_params(pbrt_t *p, const char *kind, const char *name)
{
    char what[100];
    snprintf(what, sizeof what, "%s \"%.60s\"", kind, name);
    return params_finish(p->params, what, p->dialect.dialect == DIALECT_V4, p->report);
}
