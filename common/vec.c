/* vec: the transforms that are too long to inline. */
#include "common/vec.h"

xform_t xform_multiply(const xform_t *a, const xform_t *b)
{
    xform_t c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            double sum = j == 3 ? a->m[i][3] : 0;
            for (int k = 0; k < 3; k++) sum += (double)a->m[i][k] * b->m[k][j];
            c.m[i][j] = (float)sum;
        }
    return c;
}

bool xform_invert(const xform_t *t, xform_t *inverse)
{
    double m[3][4];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) m[i][j] = t->m[i][j];
    double cofactor[3][3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            cofactor[i][j] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    double determinant = m[0][0] * cofactor[0][0] + m[0][1] * cofactor[1][0] + m[0][2] * cofactor[2][0];
    if (!isfinite(determinant) || determinant == 0) return false;
    for (int i = 0; i < 3; i++) {
        double shift = 0;
        for (int j = 0; j < 3; j++) {
            inverse->m[i][j] = (float)(cofactor[i][j] / determinant);
            shift -= cofactor[i][j] / determinant * m[j][3];
        }
        inverse->m[i][3] = (float)shift;
        for (int j = 0; j < 4; j++)
            if (!isfinite(inverse->m[i][j])) return false;
    }
    return true;
}
