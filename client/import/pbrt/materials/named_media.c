/* named_media: see named_media.h. */
#include "client/import/pbrt/materials/named_media.h"

#include <math.h>
#include <string.h>

/* The share of scattering in what happens to light in the medium, with the reduced coefficient of scattering:
 * sigma_s' / (sigma_s' + sigma_a), for red, green and blue. Measured by Jensen, Marschner, Levoy and
 * Hanrahan, "A Practical Model for Subsurface Light Transport", 2001 (up to Wholemilk), and by Narasimhan,
 * Gupta, Donner, Ramamoorthi, Nayar and Jensen, "Acquiring Scattering Properties of Participating Media by
 * Dilution", 2006. */
static const struct {
    const char *name;
    float albedo[3];
} media[] = {
    {"Apple", {0.998692f, 0.998579f, 0.977183f}},
    {"Chicken1", {0.909091f, 0.731707f, 0.666667f}},
    {"Chicken2", {0.913462f, 0.739645f, 0.615385f}},
    {"Cream", {0.999973f, 0.999488f, 0.994852f}},
    {"Ketchup", {0.746888f, 0.0673077f, 0.0202703f}},
    {"Marble", {0.999042f, 0.998438f, 0.997639f}},
    {"Potato", {0.996483f, 0.987306f, 0.820896f}},
    {"Skimmilk", {0.998004f, 0.997955f, 0.992582f}},
    {"Skin1", {0.958549f, 0.838095f, 0.677852f}},
    {"Skin2", {0.988214f, 0.957831f, 0.925065f}},
    {"Spectralon", {1, 1, 1}},
    {"Wholemilk", {0.999569f, 0.999253f, 0.9963f}},
    {"Lowfat Milk", {0.996787f, 0.996215f, 0.995479f}},
    {"Reduced Milk", {0.998973f, 0.998389f, 0.997182f}},
    {"Regular Milk", {0.999663f, 0.999212f, 0.997214f}},
    {"Espresso", {0.131068f, 0.113948f, 0.103778f}},
    {"Mint Mocha Coffee", {0.0773039f, 0.0620762f, 0.05798f}},
    {"Lowfat Soy Milk", {0.995321f, 0.979436f, 0.944931f}},
    {"Regular Soy Milk", {0.996774f, 0.987192f, 0.957531f}},
    {"Lowfat Chocolate Milk", {0.982596f, 0.957989f, 0.87608f}},
    {"Regular Chocolate Milk", {0.993148f, 0.980145f, 0.953576f}},
    {"Coke", {0.000888495f, 0.000507044f, 0}},
    {"Pepsi", {0.000672794f, 0.000300545f, 0}},
    {"Sprite", {0.00318737f, 0.0034911f, 0.00326045f}},
    {"Gatorade", {0.0901752f, 0.134867f, 0.295984f}},
    {"Chardonnay", {0.001665f, 0.00115918f, 0.00050077f}},
    {"White Zinfandel", {0.00144762f, 0.00117688f, 0.000648674f}},
    {"Merlot", {0.000181612f, 0, 0}},
    {"Budweiser Beer", {0.00211491f, 0.000965668f, 0.000182779f}},
    {"Coors Light Beer", {0.00819351f, 0.00306623f, 0}},
    {"Clorox", {0.417441f, 0.174011f, 0.131768f}},
    {"Apple Juice", {0.0103963f, 0.00662612f, 0.00433115f}},
    {"Cranberry Juice", {0.00263069f, 0.00123448f, 0.00062844f}},
    {"Grape Juice", {0.000517034f, 0, 0}},
    {"Ruby Grapefruit Juice", {0.113576f, 0.0563053f, 0.0418576f}},
    {"White Grapefruit Juice", {0.942989f, 0.92724f, 0.852233f}},
    {"Shampoo", {0.048406f, 0.017847f, 0.0143983f}},
    {"Strawberry Shampoo", {0.0106993f, 0.00274383f, 0.000200163f}},
    {"Head & Shoulders Shampoo", {0.219551f, 0.155124f, 0.14417f}},
    {"Lemon Tea Powder", {0.0162915f, 0.00979536f, 0.00703229f}},
    {"Orange Powder", {0.0972919f, 0.0483486f, 0.0219176f}},
    {"Pink Lemonade Powder", {0.0941113f, 0.0523605f, 0.0377318f}},
    {"Cappuccino Powder", {0.0489179f, 0.0495875f, 0.0342481f}},
    {"Salt Powder", {0.0877512f, 0.090607f, 0.0856292f}},
    {"Sugar Powder", {0.0173178f, 0.00814952f, 0.00537752f}},
    {"Suisse Mocha Powder", {0.137828f, 0.116049f, 0.109041f}},
    {"Pacific Ocean Surface Water", {0.00550882f, 0.0101422f, 0.00646505f}},
};

static float reflectance(float albedo)
{
    float root = sqrtf(3 * (1 - albedo));
    return albedo / 2 * (1 + expf(-4.0f / 3 * root)) * expf(-root);
}

bool named_medium_colour(const char *name, rgb_t *colour)
{
    for (size_t i = 0; i < sizeof media / sizeof *media; ++i) {
        const float *albedo = media[i].albedo;
        if (strcmp(media[i].name, name) != 0) continue;
        *colour = vec3(reflectance(albedo[0]), reflectance(albedo[1]), reflectance(albedo[2]));
        return true;
    }
    return false;
}
