/* smoothed: what was learned of the cells of a grid, with some of what was of their neighbours, since what
 * little came from is not known well.
 */
#ifndef LIGHTMILL_SMOOTHED_H
#define LIGHTMILL_SMOOTHED_H

/* Of cell (x, y) of side x side, whose rows follow one another. */
static inline double smoothed(const double *lessons, int side, int x, int y)
{
    double sum = 0, weights = 0;
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            int nx = x + dx, ny = y + dy;
            if (nx < 0 || ny < 0 || nx >= side || ny >= side) continue;
            double weight = dx == 0 && dy == 0 ? 4 : 1;
            sum += weight * lessons[ny * side + nx];
            weights += weight;
        }
    return sum / weights;
}

#endif
