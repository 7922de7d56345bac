/* news: see news.h. */
#include "common/notify/news.h"

#include "common/plain_text.h"

#include <ctype.h>
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define PREFIX "LIGHTMILL_"

/* ---- the object ---------------------------------------------------------------------------------------- */

/* A text that is safe in a line and in JSON. */
static json_t *clean_text(const char *text)
{
    char *copy = mem_strdup(text);
    for (char *c = copy; *c != '\0'; c++)
        if (iscntrl((unsigned char)*c)) *c = ' ';
    plain_text_clean(copy);
    json_t *string = json_string(copy);
    free(copy);
    return string;
}

/* "job 7 (cornell) failed: its film takes 3 GB ...". */
static json_t *sentence(const news_t *news)
{
    bool failed = strcmp(news->state, "failed") == 0;
    char *text =
        mem_printf("job %llu (%s) %s%s%s%s", (unsigned long long)news->job, news->name, failed ? "" : "is ",
                   news->state, news->message[0] != '\0' ? ": " : "", news->message);
    json_t *string = clean_text(text);
    free(text);
    return string;
}

static json_t *host_name(void)
{
    char name[256] = "";
    gethostname(name, sizeof name - 1);
    return clean_text(name);
}

static json_t *make_object(const news_t *news)
{
    json_t *object = json_object();
    json_object_set_new(object, "job", json_integer((json_int_t)news->job));
    json_object_set_new(object, "name", clean_text(news->name));
    json_object_set_new(object, "state", clean_text(news->state));
    json_object_set_new(object, "message", clean_text(news->message));
    json_object_set_new(object, "text", sentence(news));
    json_object_set_new(object, "samples", json_integer((json_int_t)news->samples));
    json_object_set_new(object, "spp", json_real(isfinite(news->spp) ? news->spp : 0));
    json_object_set_new(object, "error",
                        news->error > 0 && isfinite(news->error) ? json_real(news->error) : json_null());
    json_object_set_new(object, "elapsed", json_real(isfinite(news->elapsed) ? news->elapsed : 0));
    json_object_set_new(object, "image", news->image != NULL ? clean_text(news->image) : json_null());
    json_object_set_new(object, "host", host_name());
    return object;
}

char *news_json(const news_t *news)
{
    json_t *object = make_object(news);
    char *text = json_dumps(object, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9));
    json_decref(object);
    if (text != NULL) return text;
    log_error("out of memory");
    abort();
}

/* ---- the environment ----------------------------------------------------------------------------------- */

/* "LIGHTMILL_SPP=64". */
static char *variable(const char *key, const json_t *value)
{
    char *text;
    if (json_is_string(value))
        text = mem_printf(PREFIX "%s=%s", key, json_string_value(value));
    else if (json_is_integer(value))
        text = mem_printf(PREFIX "%s=%lld", key, (long long)json_integer_value(value));
    else if (json_is_real(value))
        text = mem_printf(PREFIX "%s=%.9g", key, json_real_value(value));
    else
        text = mem_printf(PREFIX "%s=", key);
    for (char *c = text; *c != '='; c++) *c = (char)toupper((unsigned char)*c);
    return text;
}

/* True for a variable that is ours to set, or to leave out. */
static bool is_ours(const char *entry, const json_t *object)
{
    if (strncmp(entry, PREFIX, strlen(PREFIX)) != 0) return false;
    char key[16] = "";
    const char *name = entry + strlen(PREFIX);
    size_t length = strcspn(name, "=");
    if (length >= sizeof key) return false;
    for (size_t i = 0; i < length; i++) key[i] = (char)tolower((unsigned char)name[i]);
    return strcmp(key, "notify") == 0 || json_object_get(object, key) != NULL;
}

char **news_environment(const news_t *news)
{
    json_t *object = make_object(news);
    size_t count = 0, room = json_object_size(object) + 1;
    for (char **entry = environ; entry != NULL && *entry != NULL; entry++) room++;
    char **environment = mem_zalloc(room, sizeof *environment);
    for (char **entry = environ; entry != NULL && *entry != NULL; entry++)
        if (!is_ours(*entry, object)) environment[count++] = mem_strdup(*entry);
    const char *key;
    json_t *value;
    json_object_foreach(object, key, value) environment[count++] = variable(key, value);
    json_decref(object);
    return environment;
}

void news_environment_free(char **environment)
{
    for (char **entry = environment; *entry != NULL; entry++) free(*entry);
    free(environment);
}
