#include "sim/gltf_file.h"

#include <spdlog/spdlog.h>
#include <stb_image.h>

#include <filesystem>
#include <memory>
#include <set>
#include <vector>

namespace splatbus::sim {
namespace {

constexpr int kGreatestImageSide = 8192;

/// tinygltf's image callback: four channels of eight bits, of a size checked before it is decoded; `user` is
/// the Budget of all images' bytes.
bool decode_image(tinygltf::Image* image, const int index, std::string* error, std::string* /*warning*/, int /*width*/,
                  int /*height*/, const unsigned char* bytes, int size, void* user) {
  int width = 0;
  int height = 0;
  int channels = 0;
  const auto refuse = [&](const std::string& what) {
    if (error != nullptr) *error += fmt::format("image {}: {}", index, what);
    return false;
  };
  if (stbi_info_from_memory(bytes, size, &width, &height, &channels) == 0) return refuse("not a PNG or JPEG");
  if (width < 1 || height < 1 || width > kGreatestImageSide || height > kGreatestImageSide) {
    return refuse(fmt::format("{} x {} pixels, where a side has at most {}", width, height, kGreatestImageSide));
  }
  const std::size_t decoded_bytes = std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  try {
    static_cast<Budget*>(user)->take(decoded_bytes);
  } catch (const std::runtime_error& over) {
    return refuse(over.what());
  }
  const std::unique_ptr<stbi_uc, void (*)(void*)> pixels(
      stbi_load_from_memory(bytes, size, &width, &height, &channels, 4), stbi_image_free);
  if (!pixels) return refuse(fmt::format("it cannot be decoded ({})", stbi_failure_reason()));
  image->width = width;
  image->height = height;
  image->component = 4;
  image->bits = 8;
  image->pixel_type = TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
  image->image.assign(pixels.get(), pixels.get() + decoded_bytes);
  return true;
}

/// tinygltf's file callback; `user` is the Budget of all files' bytes.
bool read_bounded_file(std::vector<unsigned char>* out, std::string* error, const std::string& path, void* user) {
  std::error_code code;
  const std::uintmax_t size = std::filesystem::file_size(path, code);
  try {
    if (code) throw std::runtime_error(code.message());
    static_cast<Budget*>(user)->take(size);
  } catch (const std::runtime_error& failure) {
    if (error != nullptr) *error += fmt::format("{}: {}", path, failure.what());
    return false;
  }
  return tinygltf::ReadWholeFile(out, error, path, user);
}

}  // namespace

tinygltf::Model read_gltf_file(const std::string& path, const GltfLimits& limits) {
  Budget file_bytes(limits.file_bytes, "bytes of files");
  Budget image_bytes(limits.image_bytes, "bytes of images");
  tinygltf::TinyGLTF loader;
  loader.SetImageLoader(decode_image, &image_bytes);
  loader.SetFsCallbacks({.FileExists = tinygltf::FileExists,
                         .ExpandFilePath = tinygltf::ExpandFilePath,
                         .ReadWholeFile = read_bounded_file,
                         .WriteWholeFile = tinygltf::WriteWholeFile,
                         .user_data = &file_bytes});
  tinygltf::Model model;
  std::string error;
  std::string warning;
  const bool binary = std::filesystem::path(path).extension() != ".gltf";
  const bool loaded = binary ? loader.LoadBinaryFromFile(&model, &error, &warning, path)
                             : loader.LoadASCIIFromFile(&model, &error, &warning, path);
  if (!warning.empty()) spdlog::warn("{}: {}", path, warning);
  if (!loaded) throw std::runtime_error(error.empty() ? "not a glTF file" : error);
  const std::set<std::string> supported{"KHR_materials_unlit", "KHR_materials_specular", "KHR_materials_ior"};
  for (const std::string& extension : model.extensionsRequired) {
    if (!supported.contains(extension))
      throw std::runtime_error(fmt::format("it requires {}, which is not supported", extension));
  }
  return model;
}

}  // namespace splatbus::sim
