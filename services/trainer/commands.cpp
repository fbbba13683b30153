#include "trainer/commands.h"

namespace splatbus::trainer {

bool Commands::add(InsertBatch&& batch) {
  std::size_t rows = batch.count;
  for (const InsertBatch& waiting : inserts) {
    if (waiting.epoch == batch.epoch && waiting.batch == batch.batch) return true;
    rows += waiting.count;
  }
  if (rows > kMaxRows || inserts.size() >= kMaxInserts) return false;
  inserts.push_back(std::move(batch));
  return true;
}

}  // namespace splatbus::trainer
