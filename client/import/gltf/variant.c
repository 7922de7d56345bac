/* variant: the look of the file that is asked for (KHR_materials_variants). The file names its variants once;
 * a primitive says which material it has in which of them. */
#include "client/import/gltf/document.h"
#include "common/plain_text.h"

#include <stdio.h>
#include <string.h>

static const char extension_name[] = "KHR_materials_variants";
enum { LIST_ROOM = 240 };

static result_t all_variants(const document_t *document, item_t *extension, item_t *variants)
{
    TRY(item_extension(&document->root, extension_name, extension));
    return item_member(extension, "variants", JSON_ARRAY, variants);
}

static result_t name_of(const item_t *variants, size_t index, const char **name)
{
    item_t item;
    *name = "";
    TRY(item_element(variants, index, JSON_OBJECT, &item));
    return item_string(&item, "name", name);
}

/* "1: beach, 2: street", cut short where there is no room. */
static result_t list_names(const item_t *variants, char list[LIST_ROOM])
{
    size_t used = 0;
    list[0] = '\0';
    for (size_t i = 0; i < item_count(variants) && used + 80 < LIST_ROOM; ++i) {
        const char *name;
        TRY(name_of(variants, i, &name));
        int added = snprintf(list + used, LIST_ROOM - used, "%s%zu: %.50s", i ? ", " : "", i + 1, name);
        used += added > 0 ? (size_t)added : 0;
    }
    plain_text_clean(list);
    return result_ok();
}

/* By its name, else by its number. */
static result_t find(const item_t *variants, const char *wanted, size_t *index, bool *found)
{
    *found = true;
    for (*index = 0; *index < item_count(variants); ++*index) {
        const char *name;
        TRY(name_of(variants, *index, &name));
        if (strcmp(name, wanted) == 0) return result_ok();
    }
    *found = item_wanted_number(wanted, item_count(variants), index);
    return result_ok();
}

result_t variant_choose(document_t *document)
{
    const import_wishes_t *wishes = document->builder->report->sink.wishes;
    item_t extension, variants;
    char list[LIST_ROOM];
    document->variant = ITEM_NONE;
    TRY(all_variants(document, &extension, &variants));
    TRY(list_names(&variants, list));
    size_t count = item_count(&variants), index = 0;
    if (!wishes || !wishes->variant) {
        if (count > 0)
            item_warn(
                &extension,
                "the scene has %zu variants (%s); its materials are taken as they stand, --variant takes "
                "one of these",
                count, list);
        return result_ok();
    }
    bool found;
    TRY(find(&variants, wishes->variant, &index, &found));
    if (!found)
        return result_fail(RESULT_USAGE, "--variant: the scene has no variant '%.100s'; it has %zu%s%s",
                           wishes->variant, count, list[0] ? ": " : "", list);
    document->variant = (uint32_t)index;
    return result_ok();
}

/* Whether a mapping is for the variant that is asked for. */
static result_t is_meant(const document_t *document, const item_t *mapping, size_t count, bool *meant)
{
    item_t list;
    *meant = false;
    TRY(item_member(mapping, "variants", JSON_ARRAY, &list));
    for (size_t i = 0; i < item_count(&list); ++i) {
        const json_t *element = json_array_get(list.json, i);
        json_int_t variant = json_is_integer(element) ? json_integer_value(element) : -1;
        if (variant < 0 || (uint64_t)variant >= count)
            return item_fail(&list, "element %zu must be the index of one of the %zu variants", i, count);
        *meant = *meant || (uint64_t)variant == document->variant;
    }
    return result_ok();
}

result_t variant_material(const document_t *document, const item_t *primitive, uint32_t *material)
{
    size_t materials = document_count(document, TOP_MATERIALS);
    item_t extension, mappings, root, variants;
    TRY(item_index(primitive, "material", materials, material));
    if (document->variant == ITEM_NONE) return result_ok();
    TRY(all_variants(document, &root, &variants));
    TRY(item_extension(primitive, extension_name, &extension));
    TRY(item_member(&extension, "mappings", JSON_ARRAY, &mappings));
    for (size_t i = 0; i < item_count(&mappings); ++i) {
        item_t mapping;
        bool meant;
        TRY(item_element(&mappings, i, JSON_OBJECT, &mapping));
        TRY(is_meant(document, &mapping, item_count(&variants), &meant));
        if (meant) return item_index(&mapping, "material", materials, material);
    }
    return result_ok();
}
