// The objects that a pickle may build by name. Private to base/.
#pragma once

#include <string>

#include "effigy/base/pickle.h"

namespace effigy::pickle_detail {

enum class Global {
  kNdarray,
  kDtype,
  kReconstruct,
  kScalar,
  kFromBuffer,
  kCscMatrix,
  kCh,
  kEncode,
  kReconstructor,
  kObject,
  kSet,
  kFrozenSet,
  kOrderedDict,
  kTorchCall,  // a function or class of torch's whose calls are written down
  kTorchType,  // a storage type
};

// What a global of this module and name means. Throws Error for every unknown one.
Global known_global(PickleDialect dialect, const std::string& module, const std::string& global,
                    const std::string& file);

// Memory that arrays may still take; throws Error when used up.
struct Budget {
  uint64_t left = uint64_t{512} << 20;
  void take(uint64_t bytes, const std::string& file);
};

[[noreturn]] void damaged_pickle(const std::string& file, const std::string& why);

// function(*arguments), written into `result`. `function` is of kind kGlobal.
void call_global(const PickleValue& function, const PickleValue& arguments, PickleValue& result,
                 Budget& budget, const std::string& file);
// An instance of a class made without arguments, to be completed by build_object.
void new_instance(Global type, const PickleValue& arguments, PickleValue& result,
                  const std::string& file);
// instance.__setstate__(state).
void build_object(PickleValue& instance, const PickleValue& state, Budget& budget,
                  const std::string& file);

}  // namespace effigy::pickle_detail
