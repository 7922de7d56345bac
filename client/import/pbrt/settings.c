/* settings: see settings.h. */
#include "client/import/pbrt/settings.h"

#include "client/import/pbrt/state/arguments.h"

#include <stdlib.h>

result_t setting_keep(pbrt_t *p, setting_kind_t kind, const char *directive, const char *what, position_t at)
{
    setting_t *setting = &p->settings[kind];
    TRY(pbrt_read_string(p, 0, what));
    TRY(pbrt_read_params(p));
    if (setting->type)
        TRY(report_tolerate(p->report, at, "a second %s; the first, in line %u of %s, is dropped, as by pbrt",
                            directive, setting->at.line, setting->at.path));
    free(setting->type);
    params_destroy(&setting->params);
    *setting = (setting_t){mem_strdup(p->arguments[0]), p->params, at};
    p->params = params_new();
    return result_ok();
}

bool setting_recall(pbrt_t *p, setting_kind_t kind)
{
    setting_t *setting = &p->settings[kind];
    if (!setting->type) return false;
    free(p->arguments[0]);
    params_destroy(&p->params);
    p->arguments[0] = setting->type;
    p->params = setting->params;
    setting->type = NULL;
    setting->params = NULL;
    return true;
}

result_t setting_find(pbrt_t *p, const void *table, size_t count, size_t size, const char *kind,
                      const char *nearest, position_t at, size_t *index)
{
    const char *type = p->arguments[0];
    if (entry_knows(table, count, size, type))
        return entry_find(table, count, size, kind, type, &p->dialect, at, index);
    TRY(report_refuse(p->report, at, "unknown %s \"%.40s\"; the nearest is \"%s\"", kind, type, nearest));
    return entry_find(table, count, size, kind, nearest, &p->dialect, at, index);
}

/* The first entry of a table that the scene's dialect has. */
static const char *first_type(const pbrt_t *p, const setting_entry_t *table, size_t count)
{
    size_t i = 0;
    while (i + 1 < count && !(table[i].entry.dialects & p->dialect.dialect)) ++i;
    return table[i].entry.name;
}

result_t setting_make(pbrt_t *p, const setting_entry_t *table, size_t count, const char *directive,
                      const char *kind, position_t at)
{
    size_t index;
    TRY(setting_find(p, table, count, sizeof *table, kind, first_type(p, table, count), at, &index));
    TRY(table[index].make(p, p->params));
    return pbrt_finish_params(p, directive, p->arguments[0]);
}
