/* unit_mac: what shows that a unit was issued.
 *
 * A unit is sent to a worker with a MAC (message authentication code) over it and over what it is issued for:
 * the party, the job with its content, and the number of a check. A worker sends the MAC back with the
 * samples of the unit. So whoever issues units takes only those that it issued, to whom, and need not
 * remember them: it holds when a lease has ended, and over a restart.
 *
 * The MAC has 64 bits, like the numbers that name workers: it cannot be guessed by who is put aside after
 * some wrong ones.
 */
#ifndef LIGHTMILL_UNIT_MAC_H
#define LIGHTMILL_UNIT_MAC_H

#include "proto/wire/wire.h"

/* What the MACs of one master or relay are made with, and nobody else knows. */
typedef struct {
    uint8_t bytes[32];
} unit_secret_t;

/* One from the system's random numbers. */
unit_secret_t unit_secret_new(void);
/* The one in DATA_DIR/keys/units, which is made (mode 0600), with its directory, when it is not there.
 * RESULT_IO or RESULT_INPUT, naming the file, when it cannot be read or is damaged. */
result_t unit_secret_load(const char *data_dir, unit_secret_t *secret);

/* Makes and checks the MACs of what is issued for one purpose. */
typedef struct {
    uint8_t key[16];
} unit_mac_t;

/* `party` is a text for who gets the units, by key or address; `check` the number of a check, or 0. */
unit_mac_t unit_mac(const unit_secret_t *secret, const char *party, uint64_t job, const hash_t *content,
                    uint64_t check);
/* Fills issues[count] for units that are issued as they are. */
void unit_mac_issue(const unit_mac_t *mac, const unit_t *units, size_t count, issue_t *issues);
/* RESULT_DENIED, naming the first that was not issued for this purpose, unless all were, whole or in pieces.
 * The units need not be valid for the job. */
result_t unit_mac_check(const unit_mac_t *mac, const unit_t *units, const issue_t *issues, size_t count);

#endif
