#include "bus/remote_readers.h"

#include <sys/eventfd.h>

#include <algorithm>
#include <utility>

#include "bus/error.h"

namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_jobs = 256;
constexpr std::size_t max_prefixes = 4096;
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
      max_bytes_(max_bytes),
      resends_(resends_per_s, resend_burst),
      unsent_(std::make_shared<std::atomic<std::size_t>>(0)),
      ready_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!ready_.valid()) throw bus::Error("cannot make an eventfd");
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

RemoteReaders::~RemoteReaders() {
  thread_.request_stop();
  thread_.join();
}

void RemoteReaders::subscribe(const std::string& prefix) {
  if (prefixes_.size() < max_prefixes) prefixes_.insert(prefix);
  if (due_.size() < max_prefixes) due_.insert(prefix);
}

void RemoteReaders::unsubscribe(const std::string& prefix) {
  prefixes_.erase(prefix);
}

bool RemoteReaders::wants(std::string_view topic) const {
  return prefixes_.size() >= max_prefixes ||
         std::any_of(prefixes_.begin(), prefixes_.end(), [&](const auto& prefix) { return topic.starts_with(prefix); });
}

std::set<std::string> RemoteReaders::take_due(std::int64_t now_ns) {
  if (due_.empty() || !resends_.take(1, now_ns)) return {};
  return std::exchange(due_, {});
}

bool RemoteReaders::offer(const bus::Frames& frames, const wire::Header& header) {
  const std::size_t bytes = slab_bytes(header);
  const bool inlines = has_slab_tensors(header);
  const auto topic = frames.topic_text();
  const std::scoped_lock lock(mutex_);
  const auto waiting = topics_.find(topic);
  if (!inlines && waiting == topics_.end()) return true;  // else it would overtake those before it
  const std::size_t taken = job_bytes_ + *unsent_;
  if (jobs_.size() + done_.size() >= max_jobs || (inlines && taken > 0 && taken + bytes > max_bytes_)) {
    ++left_out_;
    return false;
  }
  jobs_.push_back({frames.share(), bytes});
  job_bytes_ += bytes;
  if (waiting == topics_.end()) {
    topics_.emplace(topic, 1);
  } else {
    ++waiting->second;
  }
  given_.notify_one();
  return false;
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
