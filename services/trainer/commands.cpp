#include "trainer/commands.h"

#include <algorithm>
#include <iterator>
#include <numeric>

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

void CommandQueue::give_back(Commands&& commands) {
  const std::scoped_lock lock(mutex_);
  if (!commands_.visibility) commands_.visibility = std::move(commands.visibility);
}

}  // namespace splatbus::trainer
