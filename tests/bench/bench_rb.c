/* x */
#include "client/import/import.h"
#include "tests/clock.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "worker/render/scene/scene.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
int main(int argc,char**argv){
 const char*name=argv[1]; int reps=atoi(argv[2]); uint32_t spp=(uint32_t)atoi(argv[3]); int integ=argc>4?atoi(argv[4]):0;
 double bi=1e9,br=1e9;
 for(int r=0;r<reps;r++){
  double t0=clock_cpu();
  char *path = mem_printf("scenes/%s/scene.pbrt", name);
  uint8_t *bytes; uint64_t size; scene_blob_t blob;
  result_t q=import_scene_blob(path, NULL, &bytes, &size); if(q.code){puts(q.message);return 1;}
  blob_open(bytes,size,&blob);
  double t1=clock_cpu();
  job_settings_t s=blob_default_settings(&blob); s.integrator=integ==0?INTEGRATOR_BDPT:integ==1?INTEGRATOR_PATH:INTEGRATOR_LIGHT; s.spp=spp; s.seed=1;
  film_t*f=render_here(&blob,&s);
  double t2=clock_cpu();
  if(t1-t0<bi)bi=t1-t0; (void)t2; double u=(double)f->counts.cpu_us*1e-6; if(u<br)br=u;
  film_destroy(&f); free(bytes); free(path);
 }
 printf("%.5f %.5f\n",bi,br); return 0; }
