#include "trainer/insert_reader.h"

#include <string>
#include <type_traits>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "trainer/memory_failure.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "trainer/cuda/device_insert_reader.h"
#endif

namespace splatbus::trainer {

namespace {

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
    for_each_plane(batch, [&](const char* /*name*/, auto& to, std::size_t /*channels*/) {
      if (reading.lost) return;
      const bus::TensorView& tensor = tensors->planes[next++];
      in_own_memory([&] {
        to.resize(tensor.elements());
        reading.lost = !bus::copy_tensor(tensor, to.data(), Device::Cpu, host_bytes_);
      });
    });
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
  const auto& insert = message.root<wire::ModelInsert>();
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
  bool lost = false;
  const InsertRows described;
  for_each_plane(described, [&]<class T>(const char* name, const T* /*planes*/, std::uint32_t channels) {
    if (lost) return;
    std::vector<std::uint32_t> shape{tensors.rows};
    if (std::is_floating_point_v<T>) shape.insert(shape.begin(), channels);
    auto tensor = message.tensor(name, bus::ElementTypeOf<T>::value, shape);
    if (!tensor && !message.announces(name)) {
      throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"" + name +
                       "\" is missing");
    }
    lost = !tensor;
    if (tensor) tensors.planes.push_back(std::move(*tensor));
  });
  if (lost) return std::nullopt;
  if (tensors.rows == 0) return std::nullopt;
  return tensors;
}

std::unique_ptr<InsertReader> make_insert_reader(Device memory, std::atomic<std::uint64_t>& host_bytes) {
  if (memory == Device::Cpu) return std::make_unique<HostInsertReader>(host_bytes);
#ifdef SPLATBUS_HAVE_CUDA
  return std::make_unique<cuda::DeviceInsertReader>(host_bytes);
#else
  throw bus::Error("this build has no CUDA memory");
#endif
}

}  // namespace splatbus::trainer
