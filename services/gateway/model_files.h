#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "bus/context.h"
#include "bus/file_descriptor.h"
#include "gateway/traffic.h"
#include "splats/file.h"

namespace splatbus::gateway {

/// A file without a name, gone with its last holder.
struct ModelFile {
  bus::FileDescriptor file;
  std::size_t bytes = 0;
  std::string etag;
};

/// The live model as files, as `splatbus export` writes them. One is written at a time, on a thread of its own, into
/// the folder for temporary files, and serves everybody who asks for that format within kFreshNs. How many such files
/// there are at once is bounded, those that are still being read included. One thread.
class ModelFiles {
 public:
  static constexpr std::int64_t kFreshNs = 1'000'000'000;
  static constexpr std::size_t kMaxFiles = 8;

  /// `max_gaussians`: of a larger model no file is made; 0: of none. `mip`: as splats::WriteOptions'.
  ModelFiles(std::shared_ptr<bus::Context> context, std::size_t max_gaussians, Traffic& traffic, bool mip = true);
  /// Waits for the export that is under way.
  ~ModelFiles();
  ModelFiles(const ModelFiles&) = delete;
  ModelFiles& operator=(const ModelFiles&) = delete;

  /// "/model.ply", "/model.glb", "/model.spz".
  [[nodiscard]] static std::optional<splats::Format> format_of_path(std::string_view path);
  [[nodiscard]] static std::string_view type_of(splats::Format format);

  /// One of the three: a file; why there is none; or neither, and it is to be asked for again a little later.
  struct Found {
    std::shared_ptr<const ModelFile> file;
    std::string problem;
  };
  [[nodiscard]] Found find(splats::Format format, std::int64_t now_ns);

 private:
  struct Job {
    splats::Format format{};
    std::atomic<bool> done = false;
    Found found;  ///< once it is done
    std::jthread thread;
  };
  struct Made {
    Found found;
    std::int64_t made_ns = 0;
  };
  [[nodiscard]] bool has_room();
  void collect(std::int64_t now_ns);
  void start(splats::Format format);
  [[nodiscard]] Found make(splats::Format format, std::uint64_t number, const std::stop_token& stop) const;

  std::shared_ptr<bus::Context> context_;
  std::size_t max_gaussians_;
  bool mip_;
  Traffic& traffic_;
  std::uint64_t number_ = 0;
  std::map<splats::Format, Made> made_;
  std::vector<std::weak_ptr<const ModelFile>> alive_;
  std::unique_ptr<Job> job_;
};

}  // namespace splatbus::gateway
