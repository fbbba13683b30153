#include "gateway/site.h"

#include <fmt/format.h>

#include <algorithm>
#include <initializer_list>

#include "gateway/foxglove/protocol.h"
#include "gateway/metrics.h"
#include "gateway/partial_content.h"

namespace splatbus::gateway {

namespace {

constexpr std::size_t kMaxToken = 256;
constexpr std::string_view kTokenProtocol = "splatbus.token.";
constexpr double kFetchS = 20, kExportS = 60;  // in which pages come, and files are made
constexpr std::int64_t kBenchEveryNs = 500'000'000;

Response text(int status, std::string body, std::string type = "text/plain; charset=utf-8") {
  const std::size_t bytes = body.size();
  return {.status = status,
          .fields = {{"Cache-Control", "no-store"}},
          .type = std::move(type),
          .body = std::make_shared<const std::string>(std::move(body)),
          .bytes = bytes};
}

/// Calls `take` with each part of a list, trimmed, until it returns true.
template <class Take>
bool any_of_list(std::string_view list, char separator, const Take& take) {
  while (!list.empty()) {
    const std::size_t end = std::min(list.find(separator), list.size());
    std::string_view part = list.substr(0, end);
    list.remove_prefix(std::min(end + 1, list.size()));
    while (part.starts_with(' ') || part.starts_with('\t')) part.remove_prefix(1);
    while (part.ends_with(' ') || part.ends_with('\t')) part.remove_suffix(1);
    if (take(part)) return true;
  }
  return false;
}

/// As `Authorization: Bearer T`; since no page can set that for a WebSocket, also as its subprotocol
/// `splatbus.token.T`, and, for links, as the query's `token=T`.
std::string_view token_of(const Request& request) {
  std::string_view token;
  if (request.authorization && request.authorization->starts_with("Bearer ")) return request.authorization->substr(7);
  const auto take = [&](std::string_view prefix) {
    return [&token, prefix](std::string_view part) {
      if (!part.starts_with(prefix)) return false;
      token = part.substr(prefix.size());
      return true;
    };
  };
  if (request.protocols && any_of_list(*request.protocols, ',', take(kTokenProtocol))) return token;
  const std::size_t query = std::min(request.target.find('?'), request.target.size());
  any_of_list(request.target.substr(std::min(query + 1, request.target.size())), '&', take("token="));
  return token;
}

/// The first of `ours` that the client has named too; empty when it has named none.
std::string_view agreed(const Request& request, std::initializer_list<std::string_view> ours) {
  if (!request.protocols) return {};
  for (const std::string_view name : ours) {
    if (any_of_list(*request.protocols, ',', [&](std::string_view part) { return part == name; })) return name;
  }
  return {};
}

/// The page's address with what the stream does not say, where this one does not have it: how the model was trained.
std::optional<Response> unfiltered(std::string_view target) {
  const std::string_view query = target.substr(std::min(target.find('?'), target.size() - 1) + 1);
  if (any_of_list(query, '&', [](std::string_view part) { return part.starts_with("mip="); })) return std::nullopt;
  Response response = text(302, "the page, and how it is to draw the model\n");
  response.fields.emplace_back("Location", fmt::format("/?{}{}mip=0", query, query.empty() ? "" : "&"));
  return response;
}

/// What a body of 200 is reduced to by what its receiver has, or wants of it.
void reduce(const Request& request, Response& response) {
  const std::size_t bytes = response.file ? response.file->bytes : response.body ? response.body->size() : 0;
  response.bytes = bytes;
  const auto etag = std::find_if(response.fields.begin(), response.fields.end(),
                                 [](const auto& field) { return field.first == "ETag"; });
  if (response.status != 200 || etag == response.fields.end()) return;
  const std::string tag = etag->second;  // of our own: fields are added below
  const auto is_it = [&](std::string_view part) {
    if (part.starts_with("W/")) part.remove_prefix(2);
    return part == tag || part == "*";
  };
  if (request.if_none_match && any_of_list(*request.if_none_match, ',', is_it)) {
    response.status = 304;
    response.body = nullptr;
    response.file = nullptr;
    response.bytes = 0;
    return;
  }
  response.fields.emplace_back("Accept-Ranges", "bytes");
  if (!request.range || request.method != "GET" || (request.if_range && *request.if_range != tag)) return;
  const PartialContent part = partial_content(*request.range, bytes);
  if (part.kind == PartialContent::Kind::Whole) return;
  const bool none = part.kind == PartialContent::Kind::Nothing;
  response.status = none ? 416 : 206;
  response.fields.emplace_back("Content-Range",
                               none ? fmt::format("bytes */{}", bytes)
                                    : fmt::format("bytes {}-{}/{}", part.first, part.first + part.bytes - 1, bytes));
  response.first = part.first;
  response.bytes = part.bytes;
}

}  // namespace

Response unavailable(const std::string& problem) {
  Response response = text(503, problem + "\n");
  response.fields.emplace_back("Retry-After", "1");
  return response;
}

const std::vector<std::pair<std::string, std::string>>& common_fields() {
  static const std::vector<std::pair<std::string, std::string>> fields{
      {"Cross-Origin-Opener-Policy", "same-origin"},
      {"Cross-Origin-Embedder-Policy", "require-corp"},
      {"Cross-Origin-Resource-Policy", "same-origin"},
      {"Content-Security-Policy",
       "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; connect-src 'self'; "
       "img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; object-src 'none'; base-uri 'none'; "
       "form-action 'none'; frame-ancestors 'self'"},
      {"X-Content-Type-Options", "nosniff"},
      {"Referrer-Policy", "no-referrer"}};
  return fields;
}

Site::Site(const Options& options, PipelineView& pipeline, PageLibrary& pages, ModelFiles& models, Traffic& traffic)
    : options_(options),
      pipeline_(pipeline),
      pages_(pages),
      models_(models),
      traffic_(traffic),
      files_(web_root(options)),
      tokens_(options.tokens),
      origins_(options.origins, tokens_.required()) {}

std::optional<bus::Rights> Site::rights_of(std::string_view token) const {
  if (!tokens_.required()) return bus::Rights::all();
  return token.size() > kMaxToken ? std::nullopt : tokens_.find(token);
}

std::optional<Response> Site::refuse_stranger(const Request& request) {
  if (!origins_.host_allowed(request.host)) {
    traffic_.refuse(Refusal::Host);
    return text(421, "this is not the host that was asked for; 'origins' names further ones\n");
  }
  if (!origins_.origin_allowed(request.origin, request.host)) {
    traffic_.refuse(Refusal::Origin);
    return text(403, "pages of this origin may not connect; 'origins' names those that may\n");
  }
  return std::nullopt;
}

Response Site::answer(const Request& request, std::int64_t now_ns, bool again) {
  traffic_.requests += again ? 0 : 1;
  Response response = choose(request, now_ns);
  if (response.pending_s == 0) reduce(request, response);
  return response;
}

Response Site::choose(const Request& request, std::int64_t now_ns) {
  if (auto refusal = refuse_stranger(request)) return std::move(*refusal);
  const std::string_view path = request.target.substr(0, request.target.find('?'));
  const bool reads = request.method == "GET" || request.method == "HEAD";
  if (path == "/bench" && request.method == "POST") return take_bench(request, now_ns);
  if (!reads || path == "/bench") {
    Response response = text(405, "only GET and HEAD, and POST to /bench\n");
    response.fields.emplace_back("Allow", path == "/bench" ? "POST" : "GET, HEAD");
    return response;
  }
  if (path == "/healthz") {
    const std::string ill = pipeline_.ill_because(now_ns);
    return ill.empty() ? text(200, "ok\n") : text(503, ill + "\n");
  }
  const auto name = parse_page_path(path);
  const auto format = ModelFiles::format_of_path(path);
  const bool manifest_asked = path == "/manifest" || path == "/manifest.json";
  if (path == "/status" || path == "/metrics" || name || format || manifest_asked) {
    const auto rights = rights_of(token_of(request));
    if (!rights) {
      traffic_.refuse(Refusal::Token);
      return text(401, "a token is needed\n");
    }
    if (name) return page(*name, now_ns);
    if (format) return model(*format, now_ns);
    if (manifest_asked) return manifest(path.ends_with(".json"), now_ns);
    if (path == "/metrics") {
      return text(200, metrics_text(pipeline_, traffic_, now_ns), "text/plain; version=0.0.4; charset=utf-8");
    }
    auto status = status_json(pipeline_, traffic_, bench_, now_ns);
    status["rights"] = bus::to_text(*rights);
    return text(200, status.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n", "application/json");
  }
  if (path == "/stream" || path == "/foxglove") {
    Response response = text(426, path == "/stream" ? "a WebSocket of subprotocol splatbus.stream.1\n"
                                                    : "a WebSocket of subprotocol foxglove.sdk.v1\n");
    response.fields.emplace_back("Upgrade", "websocket");
    return response;
  }
  if (path == "/" && !options_.mip) {
    if (auto elsewhere = unfiltered(request.target)) return std::move(*elsewhere);
  }
  return file(path);
}

Response Site::file(std::string_view path) const {
  const StaticFiles::File* found = files_.find(path);
  if (found == nullptr) {
    const bool unbuilt = files_.size() == 0 && path == "/";
    return text(404, unbuilt ? "the page is not built; /status, /metrics and /stream are here\n" : "not here\n");
  }
  return {.fields = {{"ETag", found->etag}, {"Cache-Control", "no-cache"}}, .type = found->type, .body = found->body};
}

std::string_view Site::audience() const {
  return tokens_.required() && !options_.shared_caches ? "private" : "public";
}

Response Site::page(const PageName& name, std::int64_t now_ns) {
  PageLibrary::Found found = pages_.page(name, now_ns);
  if (found.state == PageLibrary::State::Waits) return {.pending_s = kFetchS};
  if (found.state == PageLibrary::State::Absent) return text(404, "not a page that rests; /manifest names them\n");
  return {
      .fields = {{"ETag", found.etag}, {"Cache-Control", fmt::format("{}, max-age=31536000, immutable", audience())}},
      .type = "application/octet-stream",
      .body = std::move(found.body)};
}

Response Site::manifest(bool json, std::int64_t now_ns) {
  PageLibrary::Found found = pages_.manifest(json, now_ns);
  if (found.state == PageLibrary::State::Waits) return {.pending_s = kFetchS};
  return {
      .fields = {{"ETag", found.etag}, {"Cache-Control", fmt::format("{}, max-age=1, must-revalidate", audience())}},
      .type = json ? "application/json" : "application/octet-stream",
      .body = std::move(found.body)};
}

Response Site::model(splats::Format format, std::int64_t now_ns) {
  ModelFiles::Found found = models_.find(format, now_ns);
  if (!found.problem.empty()) return unavailable(found.problem);
  if (!found.file) return {.pending_s = kExportS};
  const char* name = format == splats::Format::Ply ? "ply" : format == splats::Format::Glb ? "glb" : "spz";
  return {.fields = {{"ETag", found.file->etag},
                     {"Cache-Control", "private, no-cache"},
                     {"Content-Disposition", fmt::format("attachment; filename=\"model.{}\"", name)}},
          .type = std::string(ModelFiles::type_of(format)),
          .file = std::move(found.file)};
}

Response Site::take_bench(const Request& request, std::int64_t now_ns) {
  if (!rights_of(token_of(request))) {
    traffic_.refuse(Refusal::Token);
    return text(401, "a token is needed\n");
  }
  // With this type a browser asks us first before it lets a foreign page post; we never agree.
  if (!request.content_type || !request.content_type->starts_with("application/json")) {
    return text(415, "application/json was expected\n");
  }
  if (bench_ns_ != 0 && now_ns - bench_ns_ < kBenchEveryNs) return text(429, "too many reports\n");
  bench_ns_ = now_ns;
  const std::string problem = bench_.add(request.body);
  if (problem.empty()) return {.status = 204, .fields = {{"Cache-Control", "no-store"}}};
  traffic_.refuse(Refusal::Malformed);
  return text(400, problem + "\n");
}

Site::Admission Site::admit(const Request& request) {
  ++traffic_.requests;
  if (auto refusal = refuse_stranger(request)) return {.refusal = std::move(*refusal)};
  const std::string_view path = request.target.substr(0, request.target.find('?'));
  // Who has only a host and a port to type says the rest by the subprotocol.
  std::string_view subprotocol;
  if (path == "/stream") subprotocol = agreed(request, {kSubprotocol});
  if (path == "/foxglove" || path == "/") {
    subprotocol = agreed(request, {foxglove::kSdkSubprotocol, foxglove::kLegacySubprotocol});
  }
  if (subprotocol.empty()) {
    if (path != "/stream" && path != "/foxglove") return {.refusal = text(404, "not here\n")};
    traffic_.refuse(Refusal::Malformed);
    return {.refusal =
                text(400, path == "/stream" ? fmt::format("subprotocol {} was expected\n", kSubprotocol)
                                            : fmt::format("subprotocol {} or {} was expected\n",
                                                          foxglove::kSdkSubprotocol, foxglove::kLegacySubprotocol))};
  }
  const std::string_view token = token_of(request);
  const auto rights = rights_of(token);
  if (!rights) {
    traffic_.refuse(Refusal::Token);
    return {.refusal = text(401, "a token is needed\n")};
  }
  return {
      .rights = rights, .refusal = {}, .token = std::string(token.substr(0, kMaxToken)), .subprotocol = subprotocol};
}

}  // namespace splatbus::gateway
