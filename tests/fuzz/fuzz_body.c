/* fuzz_body: any bytes as the JSON body of each order and of a submission. What is accepted is within the
 * limits that hold for the other sockets, and together with a scene makes settings that are right, or an
 * error with a reason. */
#include "tests/fuzz/fuzz.h"

#include "master/http/parse/bodies.h"

#include <string.h>

/* The object of these bytes; NULL with a reason. */
static json_t *parse(const uint8_t *data, size_t size)
{
    json_t *body = NULL;
    result_t result = body_parse((const char *)data, size, &body);
    fuzz_expect((result.code == RESULT_OK) == (body != NULL), "neither an object nor an error");
    fuzz_expect(body == NULL || json_is_object(body), "no object");
    fuzz_expect(body != NULL || (result.code == RESULT_USAGE && result.message[0] != '\0'),
                "an error without text");
    return body;
}

static void check_refusal(const result_t *result)
{
    fuzz_expect(result->code == RESULT_USAGE && result->message[0] != '\0', "a refusal without a reason");
}

static void check_order(const uint8_t *data, size_t size, order_kind_t kind)
{
    json_t *body = parse(data, size);
    if (body == NULL) return;
    job_order_t order = {.job = 1}, again;
    result_t result = body_order(body, kind, &order);
    if (result.code != RESULT_OK) {
        check_refusal(&result);
    } else {
        Lm__JobOrder message = LM__JOB_ORDER__INIT;
        wire_order_put(&order, &message);
        fuzz_expect(wire_order_get(&message, &again).code == RESULT_OK, "an order that nobody could send");
        fuzz_expect(json_object_size(body) == 0, "a member that nobody has read");
    }
    json_decref(body);
}

static void check_applied(const http_submission_t *submission)
{
    blob_scene_t scene = blob_default_scene();
    scene_blob_t blob = {.scene = &scene};
    job_settings_t settings;
    result_t result = overrides_apply(&submission->overrides, &blob, &settings);
    if (result.code == RESULT_OK)
        fuzz_expect(job_settings_check(&settings).code == RESULT_OK, "settings that are wrong");
    else
        check_refusal(&result);
}

static void check_submission(const uint8_t *data, size_t size)
{
    json_t *body = parse(data, size);
    if (body == NULL) return;
    http_submission_t submission;
    result_t result = body_submission(body, &submission);
    if (result.code != RESULT_OK) {
        check_refusal(&result);
    } else {
        fuzz_expect(job_terms_check(&submission.terms).code == RESULT_OK, "terms out of bounds");
        fuzz_expect(memchr(submission.terms.name, '\0', sizeof submission.terms.name) != NULL,
                    "a name without an end");
        fuzz_expect(json_object_size(body) == 0, "a member that nobody has read");
        check_applied(&submission);
    }
    json_decref(body);
}

int fuzz_body(const uint8_t *data, size_t size)
{
    for (order_kind_t kind = ORDER_CANCEL; kind <= ORDER_EXTEND; kind++) check_order(data, size, kind);
    check_submission(data, size);
    return 0;
}
