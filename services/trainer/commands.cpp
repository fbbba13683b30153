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

bool Commands::add(CellsCommand&& command) {
  const std::size_t waiting =
      std::accumulate(cells.begin(), cells.end(), cells.size(),
                      [](std::size_t sum, const CellsCommand& other) { return sum + other.cells.size(); });
  if (waiting + command.cells.size() > kMaxCells) return false;
  cells.push_back(std::move(command));
  return true;
}

void CommandQueue::give_back(Commands&& commands) {
  const std::scoped_lock lock(mutex_);
  commands_.cells.insert(commands_.cells.begin(), std::make_move_iterator(commands.cells.begin()),
                         std::make_move_iterator(commands.cells.end()));
  if (!commands_.visibility) commands_.visibility = std::move(commands.visibility);
}

}  // namespace splatbus::trainer
