/* The functions of jmplan.h, compiled as C. */
#define JMPLAN_IMPLEMENTATION
#include "jmplan.h"
