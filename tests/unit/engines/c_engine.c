#include "c_engine.h"

#include <stdlib.h>
#include <string.h>

#include "sdk/splatbus_engine.h"

int run_c_engine(const char* address, int patience_ms) {
  splatbus_engine* engine = NULL;
  if (splatbus_engine_open(address, "c-engine", SPLATBUS_ENGINE_ABI, SPLATBUS_MEMORY_HOST, &engine) != SPLATBUS_OK)
    return 1;

  const splatbus_camera_request* requests = NULL;
  size_t count = 0;
  int changed = 0;
  splatbus_status status = splatbus_engine_poll(engine, patience_ms, &requests, &count, &changed);
  if (status != SPLATBUS_OK || count != 1 || changed != 1) {
    splatbus_engine_close(engine);
    return 2;
  }

  size_t pixels = (size_t)requests[0].camera.width * requests[0].camera.height;
  unsigned char* color = malloc(4 * pixels);
  float* depth = malloc(sizeof(float) * pixels);
  memset(color, 200, 4 * pixels);
  for (size_t i = 0; i < pixels; ++i) depth[i] = 1.5f;
  splatbus_image images[2] = {{SPLATBUS_BUFFER_COLOR, color, 4 * pixels, SPLATBUS_MEMORY_HOST},
                              {SPLATBUS_BUFFER_DEPTH, depth, sizeof(float) * pixels, SPLATBUS_MEMORY_HOST}};
  splatbus_object object = {7, {{1, 0, 0, 0}, {1, 2, 3}}, 1, 0};
  splatbus_frame frame;
  memset(&frame, 0, sizeof(frame));
  frame.frame = 42;
  frame.time_s = 4.2;
  frame.request_id = requests[0].request_id;
  frame.camera = requests[0].camera;
  frame.images = images;
  frame.image_count = 2;
  frame.objects = &object;
  frame.object_count = 1;
  frame.light.sun_direction[1] = 1;
  status = splatbus_engine_submit(engine, &frame);
  if (status == SPLATBUS_OK) status = splatbus_engine_counter(engine, "frames", 1);
  free(color);
  free(depth);
  splatbus_engine_close(engine);
  return status == SPLATBUS_OK ? 0 : 3;
}
