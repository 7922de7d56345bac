/* light_pool: the light vertices of a block of pixels. Each eye vertex of the block chooses a few of them to
 * be joined to.
 *
 * The light subpaths of a block are traced before its eye subpaths. Together they light an eye vertex more
 * evenly than any one of them, and many of their vertices bring it next to nothing: they face away, lie far
 * off, or are better found by another strategy. So a vertex is chosen with a chance that is about its
 * contribution, if nothing is in the way, weight included (Talbot, Cline and Egbert 2005, "Importance
 * Resampling for Global Illumination"; Popov, Ramamoorthi, Durand and Drettakis 2015, "Probabilistic
 * Connections for Bidirectional Path Tracing"). All that can contribute have some chance, and what was chosen
 * counts the more the less likely it was. So the mean is right whatever the estimate is worth.
 *
 * The pixels of a block lie POOL_STRIDE apart, and blocks are laid into one another: POOL_STRIDE x
 * POOL_STRIDE of them fill a region of the film. For pixels of a block share what luck its light subpaths
 * had, and would show it as a blotch if they were neighbours. So that there is little luck, the numbers that
 * light subpaths start by are stratified over the block (sampler_new_member).
 *
 * Regions lie on the film, whatever tiles it is cut into: what a pixel gets depends on its block and on the
 * sample's index, not on who renders it. Tiles whose sides are multiples of POOL_REGION have whole blocks,
 * others trace light subpaths that they need for a part of a block only.
 */
#ifndef LIGHTMILL_LIGHT_POOL_H
#define LIGHTMILL_LIGHT_POOL_H

#include "worker/render/integrator/subpath.h"

enum {
    POOL_SIDE = 8,   /* pixels a side of a block */
    POOL_STRIDE = 4, /* from one of them to the next */
    POOL_REGION = POOL_SIDE * POOL_STRIDE,
    POOL_PIXELS = POOL_SIDE * POOL_SIDE
};

/* A light subpath. */
typedef struct {
    uint32_t source; /* the light it starts from, */
    float last;      /* as in walk_t, where it arrived first */
    bool teaches;
    float density;       /* of its start, */
    uint32_t lessons[2]; /* whose places these are (light_ray_t); if it teaches */
} light_path_t;

/* A light vertex that was chosen. */
typedef struct {
    const vertex_t *vertex;
    const light_path_t *path;
    float factor; /* on its contribution: 1 / (how many light subpaths x how often it is chosen) */
} light_choice_t;

/* For one thread. */
typedef struct light_pool light_pool_t;

light_pool_t *light_pool_new(void);
/* Frees the pool and sets *pool to NULL. */
void light_pool_destroy(light_pool_t **pool);
/* Empties the pool for a block of so many pixels, at most POOL_PIXELS, each of which has at most one light
 * subpath. */
void light_pool_reset(light_pool_t *pool, int pixels);
/* Pixels of the block. */
int light_pool_pixels(const light_pool_t *pool);
/* Adds a subpath. */
void light_pool_add_path(light_pool_t *pool, const light_path_t *path);
/* Adds a copy of a vertex, which was weighed and shaded, to the last subpath. */
void light_pool_add(light_pool_t *pool, const vertex_t *vertex);

enum { LIGHT_CHOICES_MOST = 6 };

/* What an eye vertex asks of the pool. */
typedef struct {
    int least, most; /* lengths of the subpaths up to light vertices (walk_t) */
    bool weighted;   /* contributions are */
    float worth;     /* what the vertex makes of light from a surface, in terms of a sample's noise: the more
                        light it expects, the more it chooses. 0: not known */
    float often;     /* at most 1: the part of such vertices that choose at all, for the others, too */
    float u;         /* a uniform number */
} light_wish_t;

/* Chooses vertices for the eye vertex, some of them perhaps more than once, which makes one choice. Returns
 * how many there are in `choices`. */
int light_pool_choose(light_pool_t *pool, const vertex_t *z, const light_wish_t *wish,
                      light_choice_t choices[LIGHT_CHOICES_MOST]);

#endif
