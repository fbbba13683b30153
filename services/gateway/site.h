#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "gateway/access.h"
#include "gateway/bench_log.h"
#include "gateway/model_files.h"
#include "gateway/page_library.h"
#include "gateway/parameters.h"
#include "gateway/pipeline_view.h"
#include "gateway/static_files.h"
#include "gateway/traffic.h"
#include "stream/web_message.h"

namespace splatbus::gateway {

inline constexpr std::string_view kSubprotocol = stream::kWebSubprotocol;

/// What of a request decides its answer. Views into the request.
struct Request {
  std::string_view method, target, host, body;
  std::optional<std::string_view> origin, authorization, if_none_match, if_range, range, content_type, protocols;
};

struct Response {
  int status = 200;
  std::vector<std::pair<std::string, std::string>> fields;  ///< besides those of its body
  std::string type = "text/plain; charset=utf-8";
  std::shared_ptr<const std::string> body;  ///< null: none
  std::shared_ptr<const ModelFile> file;    ///< in place of a body
  std::size_t first = 0, bytes = 0;         ///< what of either is sent
  double pending_s = 0;                     ///< not known yet: it is to be asked again, for so long at most
};

/// 503, worth another try.
[[nodiscard]] Response unavailable(const std::string& problem);

/// Fields that every response has.
[[nodiscard]] const std::vector<std::pair<std::string, std::string>>& common_fields();

/// What there is to see, and who may see it: everything about HTTP that needs no socket. One thread; the references
/// outlive it.
class Site {
 public:
  /// Throws bus::Error and std::runtime_error.
  Site(const Options& options, PipelineView& pipeline, PageLibrary& pages, ModelFiles& models, Traffic& traffic);

  /// `now_ns`: CLOCK_MONOTONIC. `again`: it was asked before, and the answer was pending.
  [[nodiscard]] Response answer(const Request& request, std::int64_t now_ns, bool again = false);

  /// Of a request to become a WebSocket: the rights that it comes with, or what to say instead.
  struct Admission {
    std::optional<bus::Rights> rights;
    Response refusal;
    std::string token;             ///< to look at again when the tokens change
    std::string_view subprotocol;  ///< that was agreed on, a constant: of the stream, or one of Foxglove's
  };
  [[nodiscard]] Admission admit(const Request& request);

  /// Reads the tokens again when they have changed; true when they have.
  bool refresh_tokens() { return tokens_.refresh(); }
  /// Those of a token as the file has it now; all where none is asked for.
  [[nodiscard]] std::optional<bus::Rights> rights_of(std::string_view token) const;
  [[nodiscard]] std::size_t files() const { return files_.size(); }

 private:
  [[nodiscard]] std::optional<Response> refuse_stranger(const Request& request);
  [[nodiscard]] Response choose(const Request& request, std::int64_t now_ns);
  [[nodiscard]] Response file(std::string_view path) const;
  [[nodiscard]] Response page(const PageName& name, std::int64_t now_ns);
  [[nodiscard]] Response manifest(bool json, std::int64_t now_ns);
  [[nodiscard]] Response model(splats::Format format, std::int64_t now_ns);
  /// For whom caches may keep what is behind a token.
  [[nodiscard]] std::string_view audience() const;
  [[nodiscard]] Response take_bench(const Request& request, std::int64_t now_ns);

  const Options& options_;
  PipelineView& pipeline_;
  PageLibrary& pages_;
  ModelFiles& models_;
  Traffic& traffic_;
  StaticFiles files_;
  Tokens tokens_;
  OriginRule origins_;
  BenchLog bench_;
  std::int64_t bench_ns_ = 0;
};

}  // namespace splatbus::gateway
