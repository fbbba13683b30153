#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <mutex>
#include <utility>

#include "bus/context_impl.h"
#include "bus/subscriber.h"
#include "bus/token_bucket.h"

namespace splatbus::bus {
namespace {

constexpr std::size_t max_rank = 8;

std::string describe(const std::string& topic, const wire::Header& header) {
  return fmt::format("{} from {} (sequence {})", printable(topic), printable(header.source()->string_view()),
                     header.sequence());
}

// A tensor as announced, its numbers consistent with one another; where the bytes lie is not yet checked.
struct Announced {
  const wire::Span* span;
  std::vector<std::uint32_t> shape;
  ElementType type;
};

std::optional<Announced> find_tensor(const wire::Header& header, const std::string& name) {
  if (header.tensors() == nullptr) return std::nullopt;
  const wire::Tensor* found = nullptr;
  for (const auto* tensor : *header.tensors()) {
    if (tensor->name()->string_view() == name) {
      found = tensor;
      break;
    }
  }
  if (found == nullptr) return std::nullopt;
  if (found->type() > ElementType::MAX) {
    throw Error(fmt::format("element type {} does not exist", static_cast<int>(found->type())));
  }
  if (found->shape()->size() > max_rank) throw Error(fmt::format("{} axes", found->shape()->size()));
  Announced result{found->span(), {found->shape()->begin(), found->shape()->end()}, found->type()};
  const std::size_t bytes = tensor_bytes(result.shape, result.type);
  if (bytes != result.span->bytes()) {
    throw Error(fmt::format("shape [{}] of {} needs {} bytes, its span has {}", fmt::join(result.shape, ", "),
                            wire::EnumNameElementType(result.type), bytes, result.span->bytes()));
  }
  if (result.span->offset() % element_bytes(result.type) != 0) {
    throw Error(
        fmt::format("its offset {} is not aligned to {} bytes", result.span->offset(), element_bytes(result.type)));
  }
  return result;
}

}  // namespace

const std::uint8_t* Message::bytes() const {
  return content_->frames.body.data<std::uint8_t>();
}
std::size_t Message::size() const {
  return content_->frames.body.size();
}

void Message::require_schema(std::string_view schema) const {
  if (header_->schema()->string_view() == schema) return;
  throw Error(fmt::format("{}: its schema is '{}', not '{}'", describe(topic_, *header_),
                          printable(header_->schema()->string_view()), schema));
}

void Message::throw_malformed(std::string_view schema) const {
  throw Error(fmt::format("{}: its {} bytes do not verify as {}", describe(topic_, *header_), size(), schema));
}

std::optional<TensorView> Message::tensor(const std::string& name) const try {
  auto announced = find_tensor(*header_, name);
  if (!announced) return std::nullopt;
  const wire::Span& span = *announced->span;
  if (span.storage() == wire::Storage::Inline) {
    const auto& payload = content_->frames.payload;
    if (span.offset() > payload.size() || span.bytes() > payload.size() - span.offset()) {
      throw Error(fmt::format("{} bytes at {} leave the payload frame of {} bytes", span.bytes(), span.offset(),
                              payload.size()));
    }
    return TensorView(name, std::move(announced->shape), announced->type, payload.data<std::byte>() + span.offset(),
                      span.bytes(), content_);
  }
  if (span.storage() != wire::Storage::Slab) throw Error("its storage does not exist");
  if (!context_->address().is_local()) throw Error("it lies in a slab, which cannot be reached over tcp");
  const auto slab = context_->open_slab(span.slab());
  if (slab == nullptr) return std::nullopt;
  if (span.generation() % 2 != 0) throw Error(fmt::format("its generation {} is odd", span.generation()));
  TensorView view(name, std::move(announced->shape), announced->type, slab, span);
  if (!view.still_valid()) return std::nullopt;
  return view;
} catch (const Error& error) {
  throw Error(fmt::format("{}: tensor '{}': {}", describe(topic_, *header_), printable(name), error.what()));
}

std::optional<TensorView> Message::tensor(const std::string& name, ElementType type,
                                          const std::vector<std::uint32_t>& shape) const {
  auto view = tensor(name);
  if (!view) return std::nullopt;
  const bool fits = view->type() == type &&
                    std::equal(shape.begin(), shape.end(), view->shape().begin(), view->shape().end(),
                               [](std::uint32_t want, std::uint32_t have) { return want == 0 || want == have; });
  if (fits) return view;
  throw Error(fmt::format("{}: tensor '{}' is {} [{}], expected {} [{}] (0 is any)", describe(topic_, *header_), name,
                          wire::EnumNameElementType(view->type()), fmt::join(view->shape(), ", "),
                          wire::EnumNameElementType(type), fmt::join(shape, ", ")));
}

bool Message::announces(const std::string& name) const {
  const auto* tensors = header_->tensors();
  return tensors != nullptr && std::any_of(tensors->begin(), tensors->end(), [&](const wire::Tensor* tensor) {
           return tensor->name()->string_view() == name;
         });
}

std::optional<OutgoingTensor> Message::forward_tensor(const std::string& name) const {
  const auto view = tensor(name);
  if (!view) return std::nullopt;
  OutgoingTensor result;
  result.name = name;
  result.shape.assign(view->shape().begin(), view->shape().end());
  result.type = view->type();
  result.span = *find_tensor(*header_, name)->span;
  if (result.span.storage() == wire::Storage::Inline) result.inline_data = view->data();
  return result;
}

bool guarded(const Message& message, const std::function<void()>& handle) {
  // A peer has us say it: not more often than somebody reads.
  static std::mutex mutex;
  static TokenBucket said(5, 50);
  const auto say = [](const std::string& text) {
    const std::scoped_lock lock(mutex);
    if (said.take(1, now_ns())) spdlog::error("{}", text);
  };
  try {
    handle();
    return true;
  } catch (const Error& error) {
    say(error.what());
  } catch (const std::exception& error) {
    say(fmt::format("{}: {}", describe(message.topic(), message.header()), error.what()));
  }
  return false;
}

}  // namespace splatbus::bus
