#include "gateway/model_files.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <utility>

#include "bus/clock.h"
#include "model/live_scene.h"

namespace splatbus::gateway {

namespace {

constexpr std::int64_t kPatienceNs = 3'000'000'000;  // for the model and the scene, which are latched
constexpr std::chrono::milliseconds kTurn(20);
constexpr std::chrono::milliseconds kStandstill(1000);

/// Where no one else finds it.
bus::FileDescriptor nameless_file() {
  std::string path = (std::filesystem::temp_directory_path() / "splatbus-model-XXXXXX").string();
  bus::FileDescriptor file(::mkostemp(path.data(), O_CLOEXEC));
  if (!file.valid()) throw std::runtime_error(fmt::format("{}: no file can be made: {}", path, std::strerror(errno)));
  ::unlink(path.c_str());
  return file;
}

std::size_t write_model(const bus::FileDescriptor& file, splats::Format format, const splats::BakedModel& model,
                        bool mip) {
  // By its descriptor, since the writers want a stream.
  std::ofstream stream(fmt::format("/proc/self/fd/{}", file.get()), std::ios::binary | std::ios::out | std::ios::in);
  splats::write(stream, format, model, {.mip = mip});
  stream.close();
  if (!stream) throw std::runtime_error(fmt::format("the file could not be written: {}", std::strerror(errno)));
  struct stat written {};
  if (::fstat(file.get(), &written) != 0) throw std::runtime_error("the file is gone");
  return static_cast<std::size_t>(written.st_size);
}

}  // namespace

ModelFiles::ModelFiles(std::shared_ptr<bus::Context> context, std::size_t max_gaussians, Traffic& traffic, bool mip)
    : context_(std::move(context)), max_gaussians_(max_gaussians), mip_(mip), traffic_(traffic) {}

ModelFiles::~ModelFiles() = default;

std::optional<splats::Format> ModelFiles::format_of_path(std::string_view path) {
  if (path == "/model.ply") return splats::Format::Ply;
  if (path == "/model.glb") return splats::Format::Glb;
  if (path == "/model.spz") return splats::Format::Spz;
  return std::nullopt;
}

std::string_view ModelFiles::type_of(splats::Format format) {
  // None is registered for .ply and .spz.
  return format == splats::Format::Glb ? "model/gltf-binary" : "application/octet-stream";
}

ModelFiles::Found ModelFiles::find(splats::Format format, std::int64_t now_ns) {
  if (max_gaussians_ == 0) return {.file = nullptr, .problem = "no models are written here (max_model_gaussians is 0)"};
  collect(now_ns);
  const auto made = made_.find(format);
  if (made != made_.end() && now_ns - made->second.made_ns < kFreshNs) return made->second.found;
  if (job_) return {};
  if (!has_room()) return {.file = nullptr, .problem = "too many files are being read; try again later"};
  start(format);
  return {};
}

bool ModelFiles::has_room() {
  std::erase_if(alive_, [](const auto& file) { return file.expired(); });
  return alive_.size() < kMaxFiles;
}

void ModelFiles::collect(std::int64_t now_ns) {
  if (job_ && job_->done) {
    if (job_->found.file) alive_.push_back(job_->found.file);
    made_[job_->format] = {std::move(job_->found), now_ns};
    job_.reset();
  }
  std::erase_if(made_, [&](const auto& made) { return now_ns - made.second.made_ns >= kFreshNs; });
}

void ModelFiles::start(splats::Format format) {
  ++traffic_.exports;
  job_ = std::make_unique<Job>();
  job_->format = format;
  job_->thread = std::jthread([this, job = job_.get(), number = ++number_](const std::stop_token& stop) {
    try {
      job->found = make(job->format, number, stop);
    } catch (const std::exception& error) {
      job->found = {.file = nullptr, .problem = error.what()};
    }
    job->done = true;
  });
}

ModelFiles::Found ModelFiles::make(splats::Format format, std::uint64_t number, const std::stop_token& stop) const {
  const std::int64_t began_ns = bus::now_ns();
  LiveScene live(context_);
  while (!stop.stop_requested() && (!live.published() || !live.has_scene()) && bus::now_ns() - began_ns < kPatienceNs) {
    live.poll(kTurn);
  }
  if (!live.published()) return {.file = nullptr, .problem = "no model is published"};
  if (live.published()->count > max_gaussians_) {
    return {.file = nullptr,
            .problem = fmt::format("a model of {} Gaussians, at most {} are written here: use 'splatbus export'",
                                   live.published()->count, max_gaussians_)};
  }
  const auto model = live.copy_average(kStandstill);
  if (!model) return {.file = nullptr, .problem = "the model did not hold still"};
  if (model->layout().appearance == Appearance::Transfer && !live.has_scene()) {
    return {.file = nullptr, .problem = "no scene is published, whose light the model is shown in"};
  }
  auto made = std::make_shared<ModelFile>();
  made->file = nameless_file();
  made->bytes = write_model(made->file, format, splats::BakedModel(model->view(), live.scene()), mip_);
  made->etag = fmt::format("\"{:x}-{}\"", began_ns, number);
  return {.file = std::move(made), .problem = {}};
}

}  // namespace splatbus::gateway
