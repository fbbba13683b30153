#include "gateway/static_files.h"

#include <fmt/format.h>
#include <openssl/sha.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <utility>

namespace splatbus::gateway {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxFiles = 512, kMaxBytes = std::size_t{128} << 20;

std::string_view type_of(std::string_view extension) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 15> types{
      {{".html", "text/html; charset=utf-8"},
       {".js", "text/javascript; charset=utf-8"},
       {".mjs", "text/javascript; charset=utf-8"},
       {".css", "text/css; charset=utf-8"},
       {".wasm", "application/wasm"},
       {".json", "application/json"},
       {".map", "application/json"},
       {".webmanifest", "application/manifest+json"},
       {".svg", "image/svg+xml"},
       {".png", "image/png"},
       {".ico", "image/x-icon"},
       {".woff2", "font/woff2"},
       {".txt", "text/plain; charset=utf-8"},
       {".wgsl", "text/plain; charset=utf-8"},
       {".bin", "application/octet-stream"}}};
  for (const auto& [known, type] : types) {
    if (known == extension) return type;
  }
  return {};
}

}  // namespace

std::string etag_of(std::string_view bytes) {
  std::array<unsigned char, SHA256_DIGEST_LENGTH> hash{};
  ::SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), hash.data());
  std::string etag = "\"";
  for (std::size_t i = 0; i < 16; ++i) etag += fmt::format("{:02x}", hash[i]);
  return etag + '"';
}

StaticFiles::StaticFiles(const std::string& folder) {
  if (!fs::is_directory(folder)) return;
  std::size_t bytes = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const std::string_view type = type_of(entry.path().extension().string());
    if (!entry.is_regular_file() || entry.is_symlink() || type.empty()) continue;
    bytes += entry.file_size();
    if (files_.size() == kMaxFiles || bytes > kMaxBytes) {
      throw std::runtime_error(
          fmt::format("{}: more than {} files or {} MB, too much for a page", folder, kMaxFiles, kMaxBytes >> 20U));
    }
    std::ifstream stream(entry.path(), std::ios::binary);
    std::string text((std::istreambuf_iterator<char>(stream)), std::istreambuf_iterator<char>());
    if (!stream) throw std::runtime_error(entry.path().string() + ": cannot be read");
    File file{.body = std::make_shared<const std::string>(std::move(text)), .type = std::string(type), .etag = {}};
    file.etag = etag_of(*file.body);
    files_.emplace(fmt::format("/{}", entry.path().lexically_relative(folder).generic_string()), std::move(file));
  }
}

const StaticFiles::File* StaticFiles::find(std::string_view path) const {
  const auto found = files_.find(path == "/" ? std::string_view("/index.html") : path);
  return found == files_.end() ? nullptr : &found->second;
}

}  // namespace splatbus::gateway
