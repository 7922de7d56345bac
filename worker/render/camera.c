/* camera: see camera.h. */
#include "worker/render/camera.h"

void camera_init(camera_t *camera, const blob_scene_t *scene, int width, int height)
{
    const xform_t *t = &scene->world_from_camera;
    *camera = (camera_t){.position = vec3(t->m[0][3], t->m[1][3], t->m[2][3]),
                         .right = vec3(t->m[0][0], t->m[1][0], t->m[2][0]),
                         .up = vec3(t->m[0][1], t->m[1][1], t->m[2][1]),
                         .forward = vec3(t->m[0][2], t->m[1][2], t->m[2][2]),
                         .width = (float)width,
                         .height = (float)height};
    xform_invert(t, &camera->camera_from_world);
    /* The field of view spans the shorter side, which reaches from -1 to 1 in the screen window. */
    float aspect = camera->width / camera->height;
    float x = float_max(aspect, 1), y = float_max(1 / aspect, 1);
    const float automatic[4] = {-x, x, -y, y}, *w = scene->screen_window;
    bool given = w[0] != 0 || w[1] != 0 || w[2] != 0 || w[3] != 0;
    float scale = (float)tan((double)scene->fov * M_PI / 360);
    for (int i = 0; i < 4; i++) camera->window[i] = scale * (given ? w[i] : automatic[i]);
    camera->area = (camera->window[1] - camera->window[0]) * (camera->window[3] - camera->window[2]);
}

/* Density per steradian of a direction with camera-space z = cos, uniform over the film: 1 / (area cos^3). */
static float direction_pdf(const camera_t *camera, float cos)
{
    return 1 / (camera->area * cos * cos * cos);
}

vec3_t camera_ray(const camera_t *camera, vec2_t raster, float *pdf)
{
    float fx = raster.x / camera->width, fy = raster.y / camera->height;
    float x = camera->window[0] + (camera->window[1] - camera->window[0]) * fx;
    float y = camera->window[3] + (camera->window[2] - camera->window[3]) * fy;
    *pdf = direction_pdf(camera, 1 / sqrtf(1 + x * x + y * y));
    return v_normalize(v_mad(v_mad(camera->forward, x, camera->right), y, camera->up));
}

bool camera_project(const camera_t *camera, vec3_t p, float margin, camera_view_t *view)
{
    vec3_t q = xform_point(&camera->camera_from_world, p);
    if (!(q.z > 0)) return false;
    float fx = (q.x / q.z - camera->window[0]) / (camera->window[1] - camera->window[0]);
    float fy = (q.y / q.z - camera->window[3]) / (camera->window[2] - camera->window[3]);
    view->raster = (vec2_t){fx * camera->width, fy * camera->height};
    if (!(view->raster.x >= -margin && view->raster.x < camera->width + margin && view->raster.y >= -margin &&
          view->raster.y < camera->height + margin))
        return false;
    vec3_t d = v_sub(camera->position, p);
    view->distance = v_length(d);
    view->w = v_scale(d, 1 / view->distance);
    view->pdf = direction_pdf(camera, q.z / v_length(q));
    view->we_cos = view->pdf; /* We = 1 / (area cos^4) */
    return true;
}
