/* albedo: the colour of a deep medium by its albedo, in closed form, without a surface. */
#ifndef LIGHTMILL_ALBEDO_H
#define LIGHTMILL_ALBEDO_H

/* What a half space of an albedo from 0 to 1 shows of white: van de Hulst's approximation (1980, "Multiple
 * Light Scattering"), with the similar medium for a phase function with the mean cosine g. */
double colour_of_albedo(double albedo, double g);
/* The albedo that shows a colour from 0 to 1: the same, solved for it (Kulla and Conty 2017). */
double albedo_of_colour(double colour, double g);

#endif
