// Who may come in, without a socket.
#include "gateway/access.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fstream>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"
#include "gateway/parameters.h"

namespace splatbus::gateway {
namespace {

using testing::HasSubstr;

// printf %s abc | sha256sum, and the same of "xyz"
constexpr const char* kHashOfAbc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
constexpr const char* kHashOfXyz = "3608bca1e44ea6c4d268eb6db02260269892c0b42b86bbf1e77a6fa16c3c9282";

class TokenFile : public testing::Test {
 protected:
  std::string write(const std::string& text, mode_t mode = 0600) const {
    const std::string path = folder_.path() + "/tokens";
    std::ofstream(path) << text;
    ::chmod(path.c_str(), mode);
    return path;
  }
  [[nodiscard]] std::string refusal(const std::string& text, mode_t mode = 0600) const {
    try {
      const Tokens tokens(write(text, mode));
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return {};
  }
  bus_test::TemporaryDirectory folder_;
};

TEST_F(TokenFile, ATokenHasTheRightsOfItsRole) {
  const Tokens tokens(write(std::string("# who\nview ") + kHashOfAbc + "  a guest\n\nview,probe " + kHashOfXyz + "\n"));
  EXPECT_TRUE(tokens.required());
  EXPECT_EQ(tokens.find("abc"), bus::Rights{.view = true});
  EXPECT_EQ(tokens.find("xyz"), (bus::Rights{.view = true, .probe = true}));
  EXPECT_EQ(tokens.find("abd"), std::nullopt);
  EXPECT_EQ(tokens.find(""), std::nullopt);
  EXPECT_EQ(tokens.find(kHashOfAbc), std::nullopt) << "the file's content opens nothing";
  EXPECT_EQ(Tokens(write(std::string("view,steer,probe,control ") + kHashOfAbc)).find("abc"), bus::Rights::all());
  EXPECT_FALSE(Tokens().required());
}

TEST_F(TokenFile, WhatIsWrongIsNamedWithItsLine) {
  const std::string hash = kHashOfAbc;
  EXPECT_THAT(refusal("view " + hash + "\nadmin " + hash + "\n"), HasSubstr("tokens:2: expected view, or"));
  EXPECT_THAT(refusal("steer " + hash), HasSubstr("tokens:1:")) << "who may not look can do nothing";
  EXPECT_THAT(refusal("view\n"), HasSubstr("tokens:1:"));
  EXPECT_THAT(refusal("view " + hash.substr(1)), HasSubstr("tokens:1:"));
  EXPECT_THAT(refusal("view " + hash.substr(1) + "g"), HasSubstr("tokens:1:"));
  EXPECT_THROW(Tokens("/nonexistent/tokens"), std::runtime_error);
}

TEST_F(TokenFile, AFileThatOthersThanItsOwnerMayWriteToIsRefused) {
  const std::string text = std::string("view ") + kHashOfAbc;
  for (const mode_t mode : {0620, 0602, 0622}) {
    EXPECT_THAT(refusal(text, mode), HasSubstr("other than its owner may write")) << std::oct << mode;
  }
  EXPECT_EQ(refusal(text, 0644), "") << "to read it is no harm: it has hashes";
}

TEST_F(TokenFile, AChangeCountsAndABrokenFileLetsNobodyIn) {
  Tokens tokens(write(std::string("view ") + kHashOfAbc + "\n"));
  EXPECT_FALSE(tokens.refresh());
  write(std::string("view,control ") + kHashOfXyz + "\nview " + kHashOfAbc);
  EXPECT_TRUE(tokens.refresh());
  EXPECT_EQ(tokens.find("xyz"), (bus::Rights{.view = true, .control = true}));
  write("nonsense");
  EXPECT_TRUE(tokens.refresh());
  EXPECT_EQ(tokens.find("abc"), std::nullopt);
  EXPECT_EQ(tokens.find("xyz"), std::nullopt);
}

TEST(OriginRule, OwnPagesAndListedOnesMayConnect) {
  const OriginRule rule("https://a.example, http://b.example:8080", false);
  EXPECT_TRUE(rule.origin_allowed("http://localhost:7680", "localhost:7680"));
  EXPECT_TRUE(rule.origin_allowed("https://localhost:7680", "LocalHost:7680")) << "TLS may end in front of us";
  EXPECT_TRUE(rule.origin_allowed(std::nullopt, "localhost:7680"));
  EXPECT_TRUE(rule.origin_allowed("https://a.example", "localhost:7680"));
  EXPECT_TRUE(rule.origin_allowed("http://b.example:8080", "localhost:7680"));
  for (const char* origin : {"http://localhost:7681", "http://localhost", "http://evil.example", "null", "",
                             "https://a.example.evil.example", "http://a.example", "file://localhost:7680",
                             "http://localhost:7680@evil.example", "http://evil.example/localhost:7680"}) {
    EXPECT_FALSE(rule.origin_allowed(origin, "localhost:7680")) << origin;
  }
  EXPECT_FALSE(rule.origin_allowed("http://", ""));
  EXPECT_THROW(OriginRule("a.example", false), std::runtime_error);
}

TEST(OriginRule, AForeignNameThatResolvesToUsIsRefused) {
  const OriginRule rule("https://a.example:444", false);
  for (const char* host : {"localhost", "localhost:7680", "127.0.0.1:7680", "[::1]:7680", "10.0.0.7", "a.example:1"}) {
    EXPECT_TRUE(rule.host_allowed(host)) << host;
  }
  for (const char* host : {"evil.example", "evil.example:7680", "localhost.evil.example", "a.example.evil", "", ":7680",
                           "[::1", "127.0.0.1.evil.example", "local host", "localhost:port", "localhost:99999"}) {
    EXPECT_FALSE(rule.host_allowed(host)) << host;
  }
  EXPECT_TRUE(OriginRule("", true).host_allowed("any.example:7680")) << "a token protects us there";
}

std::string problem_of(const Options& options) {
  try {
    check(options);
  } catch (const bus::Error& error) {
    return error.what();
  }
  return {};
}

TEST(Options, BeyondThisMachineATokenAndTlsAreAskedFor) {
  EXPECT_EQ(problem_of({}), "");
  EXPECT_EQ(problem_of({.http = "localhost:1"}), "");
  EXPECT_EQ(problem_of({.http = "[::1]:1"}), "");
  EXPECT_EQ(problem_of({.http = "127.9.9.9:1"}), "");
  for (const char* far : {"0.0.0.0:7680", "[::]:7680", "192.168.1.4:80", "128.0.0.1:1", "example.org:1"}) {
    EXPECT_THAT(problem_of({.http = far}), HasSubstr("set 'tokens'")) << far;
    EXPECT_THAT(problem_of({.http = far, .tokens = "t"}), HasSubstr("insecure=true")) << far;
    EXPECT_THAT(problem_of({.http = far, .certificate = "c", .key = "k"}), HasSubstr("set 'tokens'")) << far;
    EXPECT_EQ(problem_of({.http = far, .certificate = "c", .key = "k", .tokens = "t"}), "") << far;
    EXPECT_EQ(problem_of({.http = far, .tokens = "t", .insecure = true}), "") << far;
  }
  EXPECT_THAT(problem_of({.certificate = "c"}), HasSubstr("go together"));
  EXPECT_THAT(problem_of({.http = "nonsense here"}), HasSubstr("not an address and port"));
}

}  // namespace
}  // namespace splatbus::gateway
