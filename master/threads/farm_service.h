/* farm_service: the farm behind the calls that the servers make (proto/serve/serve_handler.h). */
#ifndef LIGHTMILL_FARM_SERVICE_H
#define LIGHTMILL_FARM_SERVICE_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "proto/serve/serve_handler.h"

typedef struct {
    farm_t *farm; /* kept by the caller, like the store */
    blob_store_t *store;
} farm_service_t;

/* The service is kept by the caller. */
serve_handler_t farm_service_handler(farm_service_t *service);

#endif
