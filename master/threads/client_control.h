/* client_control: what clients ask on the control socket: to submit a job, to change what becomes of one, to
 * see jobs and workers. */
#ifndef LIGHTMILL_CLIENT_CONTROL_H
#define LIGHTMILL_CLIENT_CONTROL_H

#include "master/farm/farm.h"
#include "master/threads/journal_writer.h"
#include "proto/serve/peer_server.h"

typedef struct {
    farm_t *farm; /* kept by the caller, like the journal writer, whose answers wake the server */
    journal_writer_t *journal_writer;
    gate_t *gate;       /* likewise; knows the names of keys */
    uint32_t bulk_port; /* told to clients; 0: inproc */
} client_control_t;

/* The messages that are answered so; `client` is kept by the caller. */
message_table_t client_control_table(client_control_t *client);

#endif
