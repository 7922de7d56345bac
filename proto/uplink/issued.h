/* issued: how the units of one job were issued that a worker or a relay has in hand, so that it can send back
 * the MAC of each (PROTOCOL.md).
 *
 * A unit in hand is an issued one or a piece of it. Zeroed to begin with. Not thread-safe. */
#ifndef LIGHTMILL_ISSUED_H
#define LIGHTMILL_ISSUED_H

#include "proto/wire/wire.h"

typedef struct {
    unit_t unit; /* first: unit_order sorts by it */
    uint64_t mac;
    uint64_t age;   /* counts those that came */
    uint32_t reach; /* the last end of a unit of the same tile, up to this one */
} issued_unit_t;

typedef struct {
    issued_unit_t *list;
    size_t count, capacity;
    uint64_t came;
    bool sorted;
} issued_t;

/* Units with their MACs (NULL: they are not known) have come. */
void issued_add(issued_t *issued, const unit_t *units, const uint64_t *macs, size_t count);
/* Fills issues[count]: how the units at hand were issued, the last time. One that was not has MAC 0. */
void issued_find(issued_t *issued, const unit_t *units, size_t count, issue_t *issues);
/* Forgets those of which nothing is among these units, which share no samples. */
void issued_keep(issued_t *issued, const unit_t *units, size_t count);
void issued_clear(issued_t *issued);
void issued_free(issued_t *issued);

#endif
