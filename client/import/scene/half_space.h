/* half_space: how much of the light that enters a deep medium through the surface of a dielectric comes out
 * again, and what medium has that colour.
 *
 * Files give what scatters below a surface a colour: the share of the light that has entered which leaves
 * again, of light that comes evenly from all of the hemisphere. It is found by solving the equation of
 * radiative transfer for a half space below a smooth surface, by discrete ordinates, so that there is no fit.
 * Nothing depends on azimuths then. Let I+ and I- be the radiance downwards and upwards at some directions,
 * by the cosine m to the normal; with the albedo a and the phase function p, averaged over azimuths,
 *
 *   dI+/dt = -A I+ + B I-,   dI-/dt = A I- - B I+,   A = (1 - a/2 p(m, m') w') / m,  B = a/2 p(m, -m') w' / m
 *
 * (Chandrasekhar 1960, "Radiative Transfer", chapter II and section 56). S = I+ + I- and D = I+ - I- have
 * S'' = (A + B) (A - B) S, and what does not grow with the depth is D = Y S, Y = (A + B)^-1 sqrt((A + B) (A -
 * B)). So the medium reflects I- = X I+, X = (1 - Y) (1 + Y)^-1. Between it and the surface light goes back
 * and forth: with Fresnel's reflectance F from within, I+ = J + F I-, where J has entered, and (1 - F) I-
 * leaves.
 */
#ifndef LIGHTMILL_HALF_SPACE_H
#define LIGHTMILL_HALF_SPACE_H

/* The share, 0 to 1, for an albedo of single scattering from 0 to 1, Henyey and Greenstein's g over -1 and
 * below 1, and the index of refraction of the inside over the outside, over 0. To 0.0015. Beyond a g of
 * 0.8 in size it is that of the medium which is similar: with g so far, and the same s (1 - g). */
double half_space_reflectance(double albedo, double g, double eta);
/* The albedo that has such a reflectance; below 0 and over 1 stand for 0 and 1. */
double half_space_albedo(double reflectance, double g, double eta);

#endif
