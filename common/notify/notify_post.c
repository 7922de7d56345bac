/* notify_post: a URL that is told (see notify.h), by libcurl. */
#include "common/notify/notify.h"

#include <curl/curl.h>
#include <math.h>
#include <stdlib.h>

static const double CONNECT_LIMIT = 10; /* seconds until there is a connection */

/* What is answered is not looked at. */
static size_t ignore(char *bytes, size_t size, size_t count, void *context)
{
    (void)bytes, (void)context;
    return size * count;
}

/* Ends the transfer when that is wanted. */
static int check_stop(void *stop, curl_off_t a, curl_off_t b, curl_off_t c, curl_off_t d)
{
    (void)a, (void)b, (void)c, (void)d;
    return stop != NULL && atomic_load((const atomic_bool *)stop);
}

static void set_up(CURL *curl, const char *url, const char *json, double limit, const atomic_bool *stop)
{
    curl_easy_setopt(curl, CURLOPT_URL, url);
    curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(curl, CURLOPT_POSTFIELDS, json);
    curl_easy_setopt(curl, CURLOPT_USERAGENT, "lightmill/" LIGHTMILL_VERSION);
    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L); /* other threads have signals of their own */
    curl_easy_setopt(curl, CURLOPT_TIMEOUT_MS, (long)(1000 * limit));
    curl_easy_setopt(curl, CURLOPT_CONNECTTIMEOUT_MS, (long)(1000 * fmin(limit, CONNECT_LIMIT)));
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, ignore);
    curl_easy_setopt(curl, CURLOPT_NOPROGRESS, 0L);
    curl_easy_setopt(curl, CURLOPT_XFERINFOFUNCTION, check_stop);
    curl_easy_setopt(curl, CURLOPT_XFERINFODATA, (void *)stop);
}

static result_t judge(CURL *curl, CURLcode code, const char *details)
{
    long status = 0;
    curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status);
    if (code == CURLE_ABORTED_BY_CALLBACK) return result_fail(RESULT_CANCELLED, "the request was ended");
    if (code != CURLE_OK)
        return result_fail(RESULT_IO, "%.300s", details[0] != '\0' ? details : curl_easy_strerror(code));
    if (status >= 200 && status < 300) return result_ok();
    return result_fail(RESULT_IO, "it answers with status %ld%s", status,
                       status >= 300 && status < 400 ? ": give the address that it leads to" : "");
}

result_t notify_post(const char *url, const news_t *news, double limit, const atomic_bool *stop)
{
    char details[CURL_ERROR_SIZE] = "", *json = news_json(news);
    struct curl_slist *headers = curl_slist_append(NULL, "Content-Type: application/json");
    CURL *curl = curl_easy_init();
    result_t result = result_fail(RESULT_LIMIT, "libcurl has no memory");
    if (curl != NULL && headers != NULL) {
        set_up(curl, url, json, limit, stop);
        curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
        curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, details);
        result = judge(curl, curl_easy_perform(curl), details);
    }
    curl_easy_cleanup(curl);
    curl_slist_free_all(headers);
    free(json);
    return result;
}
