#include "trainer/insert_reader.h"

#include <array>
#include <string>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "trainer/insert_limits.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "trainer/cuda/device_insert_reader.h"
#endif

namespace splatbus::trainer {

namespace {

struct Plane {
  const char* name;
  bus::ElementType type;
  std::uint32_t channels;  // 0: [rows]
};
constexpr std::array<Plane, 9> kPlanes = {{{"cell", bus::ElementType::U64, 0},
                                           {"object_id", bus::ElementType::U32, 0},
                                           {"mean", bus::ElementType::F32, 3},
                                           {"log_scale", bus::ElementType::F32, 3},
                                           {"rotation", bus::ElementType::F32, 4},
                                           {"opacity_logit", bus::ElementType::F32, 1},
                                           {"albedo", bus::ElementType::F32, 3},
                                           {"normal", bus::ElementType::F32, 3},
                                           {"visibility", bus::ElementType::F32, 1}}};

class HostInsertReader final : public InsertReader {
 public:
  explicit HostInsertReader(std::atomic<std::uint64_t>& host_bytes) : host_bytes_(host_bytes) {}

  InsertReading read(const bus::Message& message) override {
    InsertReading reading;
    InsertBatch& batch = reading.batch;
    const auto tensors = find_insert_tensors(message, batch);
    reading.lost = !tensors;
    if (!tensors || tensors->rows == 0) return reading;
    std::size_t next = 0;
    const auto copy = [&](auto& to) {
      const bus::TensorView& tensor = tensors->planes[next++];
      to.resize(tensor.elements());
      return bus::copy_tensor(tensor, to.data(), bus::MemoryKind::Host, host_bytes_);
    };
    reading.lost = !(copy(batch.cell) && copy(batch.object_id) && copy(batch.mean) && copy(batch.log_scale) &&
                     copy(batch.rotation) && copy(batch.opacity_logit) && copy(batch.albedo) && copy(batch.normal) &&
                     copy(batch.visibility));
    if (reading.lost) return reading;
    batch.count = tensors->rows;
    keep_valid_rows(batch);
    return reading;
  }

 private:
  std::atomic<std::uint64_t>& host_bytes_;
};

}  // namespace

std::optional<InsertTensors> find_insert_tensors(const bus::Message& message, InsertBatch& batch) {
  const auto& insert = message.root<wire::ModelInsert>("ModelInsert/1");
  batch.epoch = message.header().epoch();
  batch.batch = insert.batch();
  batch.light = from_wire(*insert.light());
  batch.objects = from_wire(insert.objects());
  InsertTensors tensors;
  if (const auto mean = message.tensor("mean", bus::ElementType::F32, {3, 0})) {
    tensors.rows = mean->dim(1);
    if (tensors.rows == 0) return tensors;
  }
  if (tensors.rows > kMaxInsertRows) {
    throw bus::Error(message.topic() + ": " + std::to_string(tensors.rows) + " Gaussians in one batch, more than " +
                     std::to_string(kMaxInsertRows));
  }
  for (const Plane& plane : kPlanes) {
    std::vector<std::uint32_t> shape{tensors.rows};
    if (plane.channels != 0) shape.insert(shape.begin(), plane.channels);
    auto tensor = message.tensor(plane.name, plane.type, shape);
    if (!tensor && !message.announces(plane.name)) {
      throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"" + plane.name +
                       "\" is missing");
    }
    if (!tensor) return std::nullopt;
    tensors.planes.push_back(std::move(*tensor));
  }
  if (tensors.rows == 0) return std::nullopt;
  return tensors;
}

std::unique_ptr<InsertReader> make_insert_reader(bus::MemoryKind memory, std::atomic<std::uint64_t>& host_bytes) {
  if (memory == bus::MemoryKind::Host) return std::make_unique<HostInsertReader>(host_bytes);
#ifdef SPLATBUS_HAVE_CUDA
  return std::make_unique<cuda::DeviceInsertReader>(host_bytes);
#else
  throw bus::Error("this build has no CUDA memory");
#endif
}

}  // namespace splatbus::trainer
