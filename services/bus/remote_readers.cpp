#include "bus/remote_readers.h"

#include <sys/eventfd.h>

#include <algorithm>
#include <utility>

#include "bus/error.h"

namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_jobs = 256;
constexpr std::size_t max_due = 1024, max_unserved = 16;
constexpr double resends_per_s = 4, resend_burst = 8;

std::size_t slab_bytes(const wire::Header& header) {
  std::size_t bytes = 0;
  if (header.tensors() == nullptr) return bytes;
  for (const wire::Tensor* tensor : *header.tensors()) {
    if (tensor->span()->storage() == wire::Storage::Inline) continue;
    bytes += std::min<std::size_t>(tensor->span()->bytes(), static_cast<std::size_t>(bus::max_frame_bytes));
  }
  return bytes;
}

}  // namespace

RemoteReaders::RemoteReaders(FindSlab find_slab, std::size_t max_bytes)
    : find_slab_(std::move(find_slab)),
      unsent_(max_bytes),
      resends_(resends_per_s, resend_burst),
      ready_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!ready_.valid()) throw bus::Error("cannot make an eventfd");
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

RemoteReaders::~RemoteReaders() {
  thread_.request_stop();
  thread_.join();
}

void RemoteReaders::ask_for_held(const std::string& prefix) {
  due_.insert(prefix);
  if (due_.size() > max_due) due_ = {""};  // all of it: nobody is left out for those who ask for much
}

RemoteReaders::Prefixes RemoteReaders::take_due(std::int64_t now_ns) {
  if (due_.empty() || !resends_.take(1, now_ns)) return {};
  return std::exchange(due_, {});
}

RemoteReaders::Offered RemoteReaders::offer(const bus::Frames& frames, const wire::Header& header) {
  const std::size_t bytes = slab_bytes(header);
  const auto topic = frames.topic_text();
  const std::scoped_lock lock(mutex_);
  const auto waiting = topics_.find(topic);
  const bool waits = has_slab_tensors(header) || waiting != topics_.end();  // else it would overtake those before it
  const bool busy = waits && jobs_.size() + done_.size() >= max_jobs;
  const bool full = !unsent_.has_room(frames.bytes() + bytes, job_bytes_);
  if (busy || full) {
    // That copies take long is no reader's doing.
    if (full && unserved_.size() < max_unserved) unserved_.emplace(topic);
    return {.left_out = true};
  }
  if (!waits) return {.now = unsent_.share(frames)};
  jobs_.push_back({unsent_.share(frames), bytes});
  job_bytes_ += bytes;
  if (waiting == topics_.end()) {
    topics_.emplace(topic, 1);
  } else {
    ++waiting->second;
  }
  given_.notify_one();
  return {};
}

std::vector<RemoteReaders::Done> RemoteReaders::take() {
  eventfd_t count = 0;
  ::eventfd_read(ready_.get(), &count);
  std::vector<Done> result;
  const std::scoped_lock lock(mutex_);
  for (auto& done : std::exchange(done_, {})) {
    const auto topic = topics_.find(done.frames.topic_text());
    if (--topic->second == 0) topics_.erase(topic);
    result.push_back(std::move(done));
  }
  return result;
}

void RemoteReaders::run(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (given_.wait(lock, stop, [this] { return !jobs_.empty(); })) {
    const Job job = std::move(jobs_.front());
    jobs_.pop_front();
    lock.unlock();
    Done done = work(job);
    lock.lock();
    job_bytes_ -= job.bytes;
    done_.push_back(std::move(done));
    ::eventfd_write(ready_.get(), 1);
  }
}

RemoteReaders::Done RemoteReaders::work(const Job& job) {
  Done done{.frames = job.frames.share(), .complete = job.bytes == 0, .inlined = false};
  if (!has_slab_tensors(*flatbuffers::GetRoot<wire::Envelope>(job.frames.body.data())->header())) return done;
  try {
    if (auto inlined = inline_slab_tensors(job.frames, find_slab_, unsent_)) {
      done.frames = std::move(*inlined);
      done.complete = done.inlined = true;
    }
  } catch (const std::exception& error) {
    done.error = error.what();
  }
  return done;
}

}  // namespace splatbus::bus_service
