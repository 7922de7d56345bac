/* half_space: see half_space.h. A matrix is n rows of n numbers, one behind the other. */
#include "client/import/scene/half_space.h"

#include <math.h>
#include <string.h>

enum {
    TRAPPED = 6,  /* directions that are reflected completely from within, */
    LEAVING = 10, /* and those that are not */
    MOST = TRAPPED + LEAVING,
    ROOM = MOST * MOST,
    TERMS = 2 * MOST /* of the phase function, in Legendre's polynomials */
};

/* The directions of a half space, by their cosines to the normal on the inside. */
typedef struct {
    int n;
    double cosine[MOST], weight[MOST];
    double within[MOST]; /* Fresnel's reflectance, from within */
} angles_t;

/* ---- matrices ------------------------------------------------------------------------------------------ */

static void multiply(int n, const double *a, const double *b, double *out)
{
    for (int i = 0; i < n * n; ++i) {
        out[i] = 0;
        for (int k = 0; k < n; ++k) out[i] += a[i / n * n + k] * b[k * n + i % n];
    }
}

static void swap_rows(int n, double *a, int i, int k)
{
    for (int j = 0; j < n; ++j) {
        double held = a[i * n + j];
        a[i * n + j] = a[k * n + j];
        a[k * n + j] = held;
    }
}

/* Makes b the solution x of a x = b (Gauss and Jordan); a is used up. Returns log |det a|. */
static double solve(int n, double *a, double *b)
{
    double determinant = 0;
    for (int k = 0; k < n; ++k) {
        int pivot = k;
        for (int i = k + 1; i < n; ++i)
            if (fabs(a[i * n + k]) > fabs(a[pivot * n + k])) pivot = i;
        swap_rows(n, a, k, pivot);
        swap_rows(n, b, k, pivot);
        double head = fmax(fabs(a[k * n + k]), 1e-300) * (a[k * n + k] < 0 ? -1 : 1);
        determinant += log(fabs(head));
        for (int j = 0; j < n; ++j) a[k * n + j] /= head, b[k * n + j] /= head;
        for (int i = 0; i < n; ++i) {
            double factor = i != k ? a[i * n + k] : 0;
            for (int j = 0; j < n; ++j) {
                a[i * n + j] -= factor * a[k * n + j];
                b[i * n + j] -= factor * b[k * n + j];
            }
        }
    }
    return determinant;
}

static void set_identity(int n, double *a)
{
    for (int i = 0; i < n * n; ++i) a[i] = i % (n + 1) == 0;
}

static double invert(int n, const double *a, double *out)
{
    double rest[ROOM];
    memcpy(rest, a, (size_t)(n * n) * sizeof *rest);
    set_identity(n, out);
    return solve(n, rest, out);
}

/* a becomes its square root, whose eigenvalues have positive real parts: Denman and Beavers' iteration
 * (1976), scaled by determinants (Higham 2008, "Functions of Matrices", equation 6.29). */
static void take_root(int n, double *a)
{
    double z[ROOM], inverse_a[ROOM], inverse_z[ROOM], change = 1;
    set_identity(n, z);
    for (int step = 0; step < 40 && change > 1e-12; ++step) {
        double determinants = invert(n, a, inverse_a) + invert(n, z, inverse_z), size = 0;
        double scale = change > 1e-2 ? exp(-determinants / (2 * n)) : 1;
        change = 0;
        for (int i = 0; i < n * n; ++i) {
            double next = (scale * a[i] + inverse_z[i] / scale) / 2;
            change += fabs(next - a[i]);
            size += fabs(next);
            a[i] = next;
            z[i] = (scale * z[i] + inverse_a[i] / scale) / 2;
        }
        change /= size;
    }
}

/* ---- directions ---------------------------------------------------------------------------------------- */

/* Legendre's polynomial of the degree n at x; *before that of n - 1. */
static double legendre(int n, double x, double *before)
{
    double p = 1;
    *before = 0;
    for (int l = 1; l <= n; ++l) {
        double next = ((2 * l - 1) * x * p - (l - 1) * *before) / l;
        *before = p;
        p = next;
    }
    return p;
}

/* Gauss's points and weights on (0, 1). */
static void gauss(int n, double *x, double *w)
{
    for (int i = 0; i < n; ++i) {
        double root = cos(M_PI * (i + 0.75) / (n + 0.5)), before, slope = 1;
        for (int step = 0; step < 20; ++step) {
            double p = legendre(n, root, &before);
            slope = n * (root * p - before) / (root * root - 1);
            root -= p / slope;
        }
        x[i] = (1 + root) / 2;
        w[i] = 1 / ((1 - root * root) * slope * slope);
    }
}

/* Fresnel's reflectance of a dielectric (Born and Wolf 1999, section 1.5.2). */
static double fresnel(double outside, double inside, double eta)
{
    double s = (outside - eta * inside) / (outside + eta * inside);
    double p = (eta * outside - inside) / (eta * outside + inside);
    return (s * s + p * p) / 2;
}

/* Inside a denser medium the directions that leave are spread by their cosines on the outside, of which
 * Fresnel's reflectance is a smooth function. */
static void choose_angles(angles_t *angles, double eta)
{
    double x[MOST], w[MOST], critical = eta > 1 ? sqrt(1 - 1 / (eta * eta)) : 0;
    int trapped = eta > 1 ? TRAPPED : 0, leaving = eta > 1 ? LEAVING : MOST;
    angles->n = MOST;
    gauss(TRAPPED, x, w);
    for (int i = 0; i < trapped; ++i) {
        angles->cosine[i] = critical * x[i];
        angles->weight[i] = critical * w[i];
        angles->within[i] = 1;
    }
    gauss(leaving, x, w);
    for (int i = 0; i < leaving; ++i) {
        double inside = x[i], outside = x[i], weight = w[i];
        if (eta > 1) {
            inside = sqrt(1 - (1 - outside * outside) / (eta * eta));
            weight *= outside / (eta * eta * inside);
        } else {
            outside = sqrt(1 - eta * eta * (1 - inside * inside));
        }
        angles->cosine[trapped + i] = inside;
        angles->weight[trapped + i] = weight;
        angles->within[trapped + i] = fresnel(outside, inside, eta);
    }
}

/* ---- the medium ---------------------------------------------------------------------------------------- */

/* sum and difference: A + B and A - B. */
static void scatter(const angles_t *angles, double albedo, double g, double *sum, double *difference)
{
    int n = angles->n;
    double polynomials[MOST][TERMS], before;
    for (int i = 0; i < n; ++i)
        for (int l = 0; l < TERMS; ++l) polynomials[i][l] = legendre(l, angles->cosine[i], &before);
    for (int i = 0; i < n; ++i) {
        double even[MOST], odd[MOST], all = 0, power;
        for (int j = 0; j < n; ++j) {
            even[j] = odd[j] = 0, power = 1;
            for (int l = 0; l < TERMS; ++l, power *= g)
                *(l % 2 ? &odd[j] : &even[j]) += (2 * l + 1) * power * polynomials[i][l] * polynomials[j][l];
            all += even[j] * angles->weight[j]; /* 1, but for the quadrature */
        }
        for (int j = 0; j < n; ++j) { /* p(m, m') = even + odd, p(m, -m') = even - odd */
            double factor = albedo * angles->weight[j] / (all * angles->cosine[i]);
            double own = i == j ? 1 / angles->cosine[i] : 0;
            sum[i * n + j] = own - factor * odd[j];
            difference[i * n + j] = own - factor * even[j];
        }
    }
}

/* X of the head of half_space.h. */
static void reflect(const angles_t *angles, double albedo, double g, double *x)
{
    int n = angles->n;
    double sum[ROOM], difference[ROOM], y[ROOM], left[ROOM];
    scatter(angles, albedo, g, sum, difference);
    multiply(n, sum, difference, y);
    take_root(n, y);
    solve(n, sum, y);
    for (int i = 0; i < n * n; ++i) {
        double own = i % (n + 1) == 0;
        left[i] = own + y[i];
        x[i] = own - y[i];
    }
    solve(n, left, x); /* both are functions of Y, and so their order does not matter */
}

static double share_of(const angles_t *angles, double albedo, double g)
{
    int n = angles->n;
    double x[ROOM], left[ROOM], entered[ROOM] = {0}, in = 0, out = 0;
    reflect(angles, albedo, g, x);
    for (int i = 0; i < n; ++i) {
        entered[i * n] = 1 - angles->within[i];
        in += angles->weight[i] * angles->cosine[i] * entered[i * n];
        for (int j = 0; j < n; ++j) left[i * n + j] = (i == j) - angles->within[i] * x[i * n + j];
    }
    solve(n, left, entered); /* I+ */
    for (int i = 0; i < n; ++i) {
        double up = 0;
        for (int j = 0; j < n; ++j) up += x[i * n + j] * entered[j * n];
        out += angles->weight[i] * angles->cosine[i] * (1 - angles->within[i]) * up;
    }
    return out / in;
}

/* Takes a medium that scatters very much forwards, or backwards, for a similar one. */
static void soften(double *albedo, double *g)
{
    const double most = 0.8;
    double bounded = fmin(fmax(*g, -most), most), scattering = *albedo * (1 - *g) / (1 - bounded);
    *g = bounded;
    *albedo = scattering > 0 ? scattering / (scattering + 1 - *albedo) : 0;
}

/* By the root of what an interaction absorbs, of which it is nearly a linear function where that is little.
 */
static double share_by_root(const angles_t *angles, double root, double g)
{
    const double least = 1e-3;
    double albedo = 1 - fmax(root, least) * fmax(root, least);
    soften(&albedo, &g);
    double share = share_of(angles, albedo, g);
    return root < least ? 1 - (1 - share) * root / least : share;
}

double half_space_reflectance(double albedo, double g, double eta)
{
    angles_t angles;
    choose_angles(&angles, eta);
    return albedo > 0 ? share_by_root(&angles, sqrt(1 - fmin(albedo, 1)), g) : 0;
}

double half_space_albedo(double reflectance, double g, double eta)
{
    if (!(reflectance > 0)) return 0;
    if (reflectance >= 1) return 1;
    angles_t angles;
    double low = 0, high = 1, of_low = 1 - reflectance, of_high = -reflectance, root = 0.5;
    int side = 0;
    choose_angles(&angles, eta);
    for (int step = 0; step < 40 && high - low > 1e-7; ++step) { /* regula falsi, of Illinois */
        root = (low * of_high - high * of_low) / (of_high - of_low);
        double of_root = share_by_root(&angles, root, g) - reflectance;
        if (fabs(of_root) < 1e-7) break;
        if (of_root > 0) {
            low = root, of_low = of_root;
            if (side == 1) of_high /= 2;
            side = 1;
        } else {
            high = root, of_high = of_root;
            if (side == -1) of_low /= 2;
            side = -1;
        }
    }
    return 1 - root * root;
}
