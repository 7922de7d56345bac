/* notify: tells somebody that a job is over: posts JSON to a URL, or runs a command.
 *
 * Who may say what is run or called: only who started this process, by its command line. Nothing of a target
 * may come from a peer, else a client could run commands on the master's machine, or reach addresses that
 * only that machine can. What a client has chosen, a job's name, is data of the news and never part of a
 * command line.
 *
 * Thread-safe. */
#ifndef LIGHTMILL_NOTIFY_H
#define LIGHTMILL_NOTIFY_H

#include "common/notify/news.h"
#include "common/options/options.h"

#include <stdatomic.h>

enum { NOTIFY_LIMIT = 30 }; /* seconds that an attempt may take, by default */

/* Takes a target: http://... and https://... are URLs, every other text without "://" in its first word is a
 * command. The field is a const char *. */
result_t option_notify(const option_t *option, const char *text, void *field);

/* What the log calls a target, without the secrets that it may hold: "https://chat.example.org", "the
 * command". Fresh memory. */
char *notify_label(const char *target);

/* One attempt. The command is run by sh, in a process group of its own, with the JSON as its input and the
 * variables in its environment; what it prints goes to stderr. The URL gets the JSON by POST; redirections
 * are not followed. After `limit` seconds, or when *stop becomes true (NULL: never), the attempt ends: all
 * processes of the command are killed. RESULT_OK: exit code 0, or an HTTP status of 200 to 299.
 * RESULT_CANCELLED: *stop. RESULT_IO with the reason: everything else. */
result_t notify_once(const char *target, const news_t *news, double limit, const atomic_bool *stop);

/* Seconds to wait after so many failures, one after the other: 1, 2, 4, ... 60. */
double notify_pause(uint32_t failures);

/* Attempts until one succeeds, or they have taken `patience` seconds; the last failure then. */
result_t notify_insist(const char *target, const news_t *news, double limit, double patience);

/* The two kinds of attempt, for notify_once (notify_command.c, notify_post.c). */
result_t notify_command(const char *command, const news_t *news, double limit, const atomic_bool *stop);
result_t notify_post(const char *url, const news_t *news, double limit, const atomic_bool *stop);

#endif
