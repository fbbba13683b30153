#include "sim/pictures.h"

namespace splatbus::sim {
namespace {

template <class T>
void read(const DrawnPicture& drawn, std::vector<T>& pixels) {
  pixels.resize(drawn.bytes / sizeof(T));
  read_pixels(drawn, pixels.data());
}

template <class T>
void add_image(std::vector<splatbus_image>& images, splatbus_buffer buffer, const std::vector<T>& pixels) {
  if (pixels.empty()) return;
  images.push_back(
      {static_cast<std::uint32_t>(buffer), pixels.data(), pixels.size() * sizeof(T), SPLATBUS_MEMORY_HOST});
}

}  // namespace

std::vector<splatbus_image> images_of(const Pictures& pictures) {
  std::vector<splatbus_image> images;
  add_image(images, SPLATBUS_BUFFER_COLOR, pictures.color);
  add_image(images, SPLATBUS_BUFFER_WORLD_POSITION, pictures.world_position);
  add_image(images, SPLATBUS_BUFFER_NORMAL, pictures.normal);
  add_image(images, SPLATBUS_BUFFER_OBJECT_ID, pictures.object_id);
  add_image(images, SPLATBUS_BUFFER_ALBEDO, pictures.albedo);
  add_image(images, SPLATBUS_BUFFER_DEPTH, pictures.depth);
  add_image(images, SPLATBUS_BUFFER_LIGHT_DEPTH, pictures.light_depth);
  return images;
}

void HostReadback::begin(std::uint32_t width, std::uint32_t height, std::size_t /*bytes*/) {
  pictures_.width = width;
  pictures_.height = height;
  for (auto* bytes : {&pictures_.color, &pictures_.albedo}) bytes->clear();
  for (auto* floats : {&pictures_.world_position, &pictures_.normal, &pictures_.depth, &pictures_.light_depth})
    floats->clear();
  pictures_.object_id.clear();
}

void HostReadback::take(const DrawnPicture& drawn) {
  switch (drawn.buffer) {
    case SPLATBUS_BUFFER_COLOR:
      return read(drawn, pictures_.color);
    case SPLATBUS_BUFFER_ALBEDO:
      return read(drawn, pictures_.albedo);
    case SPLATBUS_BUFFER_WORLD_POSITION:
      return read(drawn, pictures_.world_position);
    case SPLATBUS_BUFFER_NORMAL:
      return read(drawn, pictures_.normal);
    case SPLATBUS_BUFFER_DEPTH:
      return read(drawn, pictures_.depth);
    case SPLATBUS_BUFFER_LIGHT_DEPTH:
      return read(drawn, pictures_.light_depth);
    case SPLATBUS_BUFFER_OBJECT_ID:
      return read(drawn, pictures_.object_id);
  }
}

}  // namespace splatbus::sim
