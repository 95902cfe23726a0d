/* What OD.c takes from CANopenNode V4's header of this name: the types that describe a dictionary. */
#ifndef CO_OD_INTERFACE_H
#define CO_OD_INTERFACE_H

#include <stddef.h>
#include <stdint.h>

#define CO_PROGMEM const

typedef uint8_t OD_attr_t;
typedef uint32_t OD_size_t;

enum { ODA_SDO_R = 1, ODA_SDO_RW = 3, ODA_TPDO = 4, ODA_MB = 0x40, ODA_STR = 0x80 };
enum { ODT_VAR = 1, ODT_ARR = 2, ODT_REC = 3 };

typedef struct {
    void *dataOrig;
    OD_attr_t attribute;
    OD_size_t dataLength;
} OD_obj_var_t;

typedef struct {
    uint8_t *dataOrig0;
    void *dataOrig;
    OD_attr_t attribute0, attribute;
    OD_size_t dataElementLength, dataElementSizeof;
} OD_obj_array_t;

typedef struct {
    void *dataOrig;
    uint8_t subIndex;
    OD_attr_t attribute;
    OD_size_t dataLength;
} OD_obj_record_t;

typedef struct {
    uint16_t index;
    uint8_t subEntriesCount, odObjectType;
    CO_PROGMEM void *odObject;
    void *extension;
} OD_entry_t;

typedef struct {
    uint16_t size;
    OD_entry_t *list;
} OD_t;

#endif
