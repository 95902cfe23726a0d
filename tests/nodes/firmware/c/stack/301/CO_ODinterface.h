/* What the sources take from CANopenNode V4's header of this name: the types that describe a dictionary, and access to it. */
#ifndef CO_OD_INTERFACE_H
#define CO_OD_INTERFACE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define CO_PROGMEM const
#define CO_LITTLE_ENDIAN
#define OD_FLAGS_PDO_SIZE 4

typedef uint8_t OD_attr_t;
typedef uint32_t OD_size_t;
typedef bool bool_t;

enum { ODA_SDO_R = 1, ODA_SDO_RW = 3, ODA_TPDO = 4, ODA_TRPDO = 12, ODA_MB = 0x40, ODA_STR = 0x80 };
enum { ODT_VAR = 1, ODT_ARR = 2, ODT_REC = 3 };

typedef enum {
    ODR_OK, ODR_READONLY, ODR_IDX_NOT_EXIST, ODR_DEV_INCOMPAT, ODR_TYPE_MISMATCH, ODR_SUB_NOT_EXIST, ODR_INVALID_VALUE,
    ODR_GENERAL
} ODR_t;

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
    void *dataOrig, *object;
    OD_size_t dataLength, dataOffset;
    OD_attr_t attribute;
    uint16_t index;
    uint8_t subIndex;
} OD_stream_t;

typedef struct {
    void *object;
    ODR_t (*read)(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead);
    ODR_t (*write)(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten);
    uint8_t flagsPDO[OD_FLAGS_PDO_SIZE]; /* a bit of 0: event-driven TPDOs that map the sub-index are to be sent */
} OD_extension_t;

typedef struct {
    uint16_t index;
    uint8_t subEntriesCount, odObjectType;
    CO_PROGMEM void *odObject;
    OD_extension_t *extension;
} OD_entry_t;

typedef struct {
    uint16_t size;
    OD_entry_t *list;
} OD_t;

OD_entry_t *OD_find(OD_t *od, uint16_t index);
void *OD_getPtr(const OD_entry_t *entry, uint8_t subIndex, OD_size_t len, ODR_t *err);
ODR_t OD_extension_init(OD_entry_t *entry, OD_extension_t *extension);
ODR_t OD_readOriginal(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead);
ODR_t OD_writeOriginal(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten);
ODR_t OD_get_value(const OD_entry_t *entry, uint8_t subIndex, void *val, OD_size_t len, bool_t odOrig);
ODR_t OD_set_value(const OD_entry_t *entry, uint8_t subIndex, void *val, OD_size_t len, bool_t odOrig);

#endif
