#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "bus/subscriber.h"
#include "trainer/insert_batch.h"

namespace splatbus::trainer {

struct InsertReading {
  bool lost = false;
  InsertBatch batch;
};

/// Copies model/insert messages out of the expander's slab, whichever memory that lies in, and checks every row. One
/// thread.
class InsertReader {
 public:
  virtual ~InsertReader() = default;

  /// `lost` when the slab moved on meanwhile (the expander repeats the batch). Throws bus::Error or std::runtime_error
  /// when the message lies about its tensors, MemoryFailure.
  [[nodiscard]] virtual InsertReading read(const bus::Message& message) = 0;
};

/// Reads into memory of a kind; what passes through the host is added to `host_bytes`. Throws bus::Error when this
/// build or machine has no such memory.
[[nodiscard]] std::unique_ptr<InsertReader> make_insert_reader(Device memory, std::atomic<std::uint64_t>& host_bytes);

/// The tensors of a message, in the order in which insert_rows_at lays them out, of `rows` rows each, which is within
/// bounds; `rows` 0 when there are none. Nullopt when the slab has moved on. Fills what else the batch says.
struct InsertTensors {
  std::uint32_t rows = 0;
  std::vector<bus::TensorView> planes;
};
[[nodiscard]] std::optional<InsertTensors> find_insert_tensors(const bus::Message& message, InsertBatch& batch);

}  // namespace splatbus::trainer
