/* texture_blocks: see texture_blocks.h. */
#include "worker/render/texture/texture_blocks.h"

#include "common/memory_limit.h"

#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

enum { FEWEST_SLOTS = 64 };
/* Fewer texels are left to the kernel; and the table covers so large a part of the memory. */
static const uint64_t few_bytes = 64 << 20, memory_part = 8;

uint32_t texture_blocks_slots(uint64_t texels, uint64_t limit)
{
    if (texels <= few_bytes) return 0;
    uint64_t covered = limit / memory_part < texels ? limit / memory_part : texels, slots = FEWEST_SLOTS;
    while (2 * slots << TEXTURE_BLOCK_BITS <= covered) slots *= 2;
    return (uint32_t)slots;
}

texture_blocks_t *texture_blocks_new(const scene_blob_t *blob)
{
    uint64_t size = blob->counts[BLOB_SECTION_TEXELS] * sizeof *blob->texels;
    uint32_t slots = blob->mapped ? texture_blocks_slots(size, memory_limit()) : 0;
    if (slots == 0) return NULL;
    texture_blocks_t *blocks = mem_zalloc(1, sizeof *blocks);
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
    blocks->end = (const uint8_t *)(blob->texels + blob->counts[BLOB_SECTION_TEXELS]);
    blocks->start = (const uint8_t *)blob->texels - (uintptr_t)blob->texels % page;
    blocks->slots = mem_zalloc(slots, sizeof *blocks->slots);
    blocks->mask = slots - 1;
    madvise((void *)blocks->start, (size_t)(blocks->end - blocks->start), MADV_RANDOM);
    return blocks;
}

void texture_blocks_free(texture_blocks_t *blocks)
{
    if (blocks == NULL) return;
    free((void *)blocks->slots);
    free(blocks);
}

void texture_blocks_read(texture_blocks_t *blocks, uint32_t block)
{
    const uint8_t *first = blocks->start + ((uint64_t)block << TEXTURE_BLOCK_BITS);
    uint64_t left = (uint64_t)(blocks->end - first), size = (uint64_t)1 << TEXTURE_BLOCK_BITS;
    madvise((void *)first, left < size ? left : size, MADV_WILLNEED);
    atomic_store_explicit(&blocks->slots[block & blocks->mask], block + 1, memory_order_relaxed);
}
