/* light_tree: see light_tree.h. */
#include "worker/render/light/light_tree.h"

#include "common/base.h"

#include <stdlib.h>

enum { ROOT = 0 };
/* Of a node beside another, however far it is. */
static const float least_share = 1.0f / 256;

typedef struct {
    vec3_t centre;
    float radius2; /* of the sphere about the box, squared */
    float power;
    uint32_t parent;
    uint32_t left, right; /* left == right: a leaf, whose light it is */
} node_t;

struct light_tree {
    uint32_t count;   /* of nodes */
    uint32_t *leaves; /* of each light */
    node_t nodes[];
};

/* ---- making one ---------------------------------------------------------------------------------------- */

/* Twice the middle of a box. */
static vec3_t middle(const light_box_t *box)
{
    return v_add(box->low, box->high);
}

/* Along an axis; what lies at the same place, by its number. */
static int box_order(const void *a, const void *b, void *axis)
{
    const light_box_t *u = a, *v = b;
    float at_u = v_at(middle(u), *(int *)axis), at_v = v_at(middle(v), *(int *)axis);
    if (at_u != at_v) return at_u < at_v ? -1 : 1;
    return u->light < v->light ? -1 : u->light > v->light;
}

/* The axis along which the middles of the boxes are spread most. */
static int longest_axis(const light_box_t *boxes, uint32_t count)
{
    vec3_t low = middle(&boxes[0]), high = low;
    for (uint32_t i = 1; i < count; i++) {
        low = v_low(low, middle(&boxes[i]));
        high = v_high(high, middle(&boxes[i]));
    }
    return v_longest(v_sub(high, low));
}

/* Fills the next node, and those below it; returns its number. */
static uint32_t make_node(light_tree_t *tree, light_box_t *boxes, uint32_t count, uint32_t parent)
{
    uint32_t number = tree->count++;
    vec3_t low = boxes[0].low, high = boxes[0].high;
    double power = 0;
    for (uint32_t i = 0; i < count; i++) {
        low = v_low(low, boxes[i].low);
        high = v_high(high, boxes[i].high);
        power += boxes[i].power;
    }
    node_t node = {.centre = v_scale(v_add(low, high), 0.5f),
                   .radius2 = 0.25f * v_length2(v_sub(high, low)),
                   .power = float_max((float)power, 1e-30f),
                   .parent = parent};
    if (count == 1) {
        node.left = node.right = boxes[0].light;
        tree->leaves[boxes[0].light] = number;
    } else {
        int axis = longest_axis(boxes, count);
        qsort_r(boxes, count, sizeof *boxes, box_order, &axis);
        node.left = make_node(tree, boxes, count / 2, number);
        node.right = make_node(tree, boxes + count / 2, count - count / 2, number);
    }
    tree->nodes[number] = node;
    return number;
}

light_tree_t *light_tree_new(light_box_t *boxes, uint32_t count, uint32_t lights)
{
    light_tree_t *tree = mem_zalloc(1, sizeof *tree + (2 * (size_t)count - 1) * sizeof *tree->nodes);
    tree->leaves = mem_zalloc(lights, sizeof *tree->leaves);
    make_node(tree, boxes, count, ROOT);
    return tree;
}

void light_tree_destroy(light_tree_t **tree)
{
    if (*tree == NULL) return;
    free((*tree)->leaves);
    free(*tree);
    *tree = NULL;
}

/* ---- choosing ------------------------------------------------------------------------------------------ */

static float worth(const node_t *node, vec3_t point)
{
    float distance2 = float_max(v_length2(v_sub(point, node->centre)), node->radius2);
    return node->power / float_max(distance2, 1e-20f);
}

/* The part of what two nodes are worth that is the first one's; never all of it. */
static float share(const node_t *node, const node_t *other, vec3_t point)
{
    float a = worth(node, point), b = worth(other, point);
    return float_clamp(a + b < INFINITY ? a / (a + b) : 0.5f, least_share, 1 - least_share);
}

uint32_t light_tree_choose(const light_tree_t *tree, vec3_t point, float *u, float *chance)
{
    const node_t *node = &tree->nodes[ROOT];
    *chance = 1;
    while (node->left != node->right) {
        const node_t *left = &tree->nodes[node->left], *right = &tree->nodes[node->right];
        float part = share(left, right, point);
        bool goes_left = *u < part;
        node = goes_left ? left : right;
        *u = float_min(goes_left ? *u / part : (*u - part) / (1 - part), 0x1.fffffep-1f);
        *chance *= goes_left ? part : 1 - part;
    }
    return node->left;
}

float light_tree_chance(const light_tree_t *tree, uint32_t light, vec3_t point)
{
    float chance = 1;
    for (uint32_t i = tree->leaves[light]; i != ROOT; i = tree->nodes[i].parent) {
        const node_t *parent = &tree->nodes[tree->nodes[i].parent];
        float part = share(&tree->nodes[parent->left], &tree->nodes[parent->right], point);
        chance *= i == parent->left ? part : 1 - part;
    }
    return chance;
}
