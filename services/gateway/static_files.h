#pragma once

#include <map>
#include <memory>
#include <string>
#include <string_view>

namespace splatbus::gateway {

/// The page's files, read once: what was not in the folder at the start does not exist, whatever a path says.
class StaticFiles {
 public:
  struct File {
    std::shared_ptr<const std::string> body;
    std::string type;  ///< MIME
    std::string etag;  ///< with its quotes
  };

  StaticFiles() = default;
  /// Every regular file of known type under `folder`; none where it does not exist. Links are not followed. Throws
  /// std::runtime_error when they are more, or larger, than a page may be, and when one cannot be read.
  explicit StaticFiles(const std::string& folder);

  /// By the path of a request, "/app.js"; "/" is index.html. Null when there is none.
  [[nodiscard]] const File* find(std::string_view path) const;
  [[nodiscard]] std::size_t size() const { return files_.size(); }

 private:
  std::map<std::string, File, std::less<>> files_;
};

/// Strong: of the bytes alone.
[[nodiscard]] std::string etag_of(std::string_view bytes);

}  // namespace splatbus::gateway
