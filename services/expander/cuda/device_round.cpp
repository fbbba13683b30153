#include "expander/cuda/device_round.h"

#include <utility>
#include <vector>

#include "bus/memory.h"
#include "device/check.h"
#include "expander/input_samples.h"

namespace splatbus::expander::cuda {

namespace {

using device::check;

DeviceRigid on_device(const Rigid& rigid) {
  const glm::vec3& t = rigid.translation;
  return {rigid.rotation.w, rigid.rotation.x, rigid.rotation.y, rigid.rotation.z, {t.x, t.y, t.z}};
}

std::vector<DeviceCamera> cameras_of(const RoundInfo& info) {
  std::vector<DeviceCamera> cameras;
  cameras.reserve(info.cameras.size());
  for (const Camera& camera : info.cameras) {
    cameras.push_back({.camera_from_world = on_device(inverse(camera.world_from_camera)),
                       .fx = camera.fx,
                       .fy = camera.fy,
                       .cx = camera.cx,
                       .cy = camera.cy,
                       .orthographic = camera.role == CameraRole::Light});
  }
  return cameras;
}

std::vector<DeviceObject> objects_of(const RoundInfo& info) {
  std::vector<DeviceObject> objects;
  objects.reserve(info.objects.size());
  for (const auto& [id, world_from_object] : info.objects) {
    objects.push_back({.id = id, .object_from_world = on_device(inverse(world_from_object))});
  }
  return objects;
}

/// Copies to the device; `from` may go at once.
template <class T>
void upload(const std::vector<T>& from, const T* to) {
  if (from.empty()) return;
  check(cudaMemcpyAsync(const_cast<T*>(to), from.data(), from.size() * sizeof(T), cudaMemcpyHostToDevice,
                        thread_stream()),
        "copying a round's cameras");
}

/// Tensors as kernels can read them.
class Readable {
 public:
  Readable(Pool& pool, std::atomic<std::uint64_t>& host_bytes) : pool_(pool), host_bytes_(host_bytes) {}

  /// In place where it lies on the device.
  template <class T>
  const T* get(const bus::TensorView& tensor) {
    if (tensor.memory() == Device::Cuda) return reinterpret_cast<const T*>(tensor.data());
    staged_.push_back(pool_.take(tensor.bytes(), "samples from the host"));
    copy(tensor, staged_.back().get());
    return reinterpret_cast<const T*>(staged_.back().get());
  }

  void copy(const bus::TensorView& tensor, std::byte* destination) {
    bus::copy_memory(destination, Device::Cuda, tensor.data(), tensor.memory(), tensor.bytes());
    if (tensor.memory() == Device::Cpu) host_bytes_ += tensor.bytes();
  }

 private:
  Pool& pool_;
  std::atomic<std::uint64_t>& host_bytes_;
  std::vector<std::shared_ptr<std::byte>> staged_;
};

/// Sets the pointers of a round whose counts are set; returns where the count of garbage goes.
std::uint32_t* lay_out(Carver& carver, RoundView& view, std::size_t depths) {
  const std::size_t n = view.count;
  Samples& samples = view.samples;
  for (float3** vectors : {&samples.position, &samples.normal, &samples.albedo, &samples.color}) {
    *vectors = carver.take<float3>(n);
  }
  for (float** scalars : {&samples.spacing_m, &samples.cosine}) *scalars = carver.take<float>(n);
  for (std::uint32_t** ids : {&samples.object_id, &samples.camera}) *ids = carver.take<std::uint32_t>(n);
  view.depth_m = carver.take<float>(depths);
  view.cameras = carver.take<DeviceCamera>(view.camera_count);
  view.objects = carver.take<DeviceObject>(view.object_count);
  return carver.take<std::uint32_t>(1);
}

bool still_valid(const IncomingRound& round) {
  for (const bus::TensorView* tensor : {&round.position, &round.normal, &round.albedo, &round.color, &round.spacing,
                                        &round.cosine, &round.object_id, &round.camera, &round.depth}) {
    if (!tensor->still_valid()) return false;
  }
  return true;
}

}  // namespace

DeviceRound::DeviceRound(const IncomingRound& incoming, Pool& pool) : info_(incoming) {
  view_.count = static_cast<std::uint32_t>(incoming.count);
  view_.height = info_.height;
  view_.width = info_.width;
  view_.camera_count = static_cast<std::uint32_t>(info_.cameras.size());
  view_.object_count = static_cast<std::uint32_t>(info_.objects.size());
  memory_ = carve(pool, "the samples of a round",
                  [&](Carver& carver) { dropped_count_ = lay_out(carver, view_, incoming.depth.elements()); });
}

std::unique_ptr<DeviceRound> DeviceRound::take(const IncomingRound& incoming, Pool& pool,
                                               std::atomic<std::uint64_t>& host_bytes) {
  std::unique_ptr<DeviceRound> round(new DeviceRound(incoming, pool));
  const RoundView& view = round->view_;
  upload(cameras_of(round->info_), view.cameras);
  upload(objects_of(round->info_), view.objects);
  Readable readable(pool, host_bytes);
  const IncomingSamples samples{.position = readable.get<float3>(incoming.position),
                                .normal = readable.get<float3>(incoming.normal),
                                .albedo = readable.get<float3>(incoming.albedo),
                                .color = readable.get<float3>(incoming.color),
                                .spacing_m = readable.get<float>(incoming.spacing),
                                .cosine = readable.get<float>(incoming.cosine),
                                .object_id = readable.get<std::uint32_t>(incoming.object_id),
                                .camera = readable.get<std::uint32_t>(incoming.camera)};
  launch_take(samples, view, {.largest_spacing_m = kLargestSpacing_m, .unit_tolerance = kUnitTolerance},
              round->dropped_count_, thread_stream());
  readable.copy(incoming.depth, reinterpret_cast<std::byte*>(const_cast<float*>(view.depth_m)));
  check(cudaMemcpyAsync(&round->dropped_, round->dropped_count_, sizeof(round->dropped_), cudaMemcpyDeviceToHost,
                        thread_stream()),
        "counting garbage");
  check(cudaStreamSynchronize(thread_stream()), "taking a round");
  return still_valid(incoming) ? std::move(round) : nullptr;
}

}  // namespace splatbus::expander::cuda
